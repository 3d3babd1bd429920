-- Open Food Facts' dump, whose path is the variable `dump`, as packaged foods: `sound`, each code once; `refused`, the
-- reasons with their number and examples; `figures`, the sums of both.

CREATE VIEW published AS
SELECT * FROM read_csv(
    getvariable('dump'), delim = '\t', quote = '', escape = '', header = TRUE, all_varchar = TRUE,
    store_rejects = TRUE, rejects_limit = 100000, sample_size = 100, max_line_size = 1000000,
    buffer_size = 4000000
);

-- fails where the file lacks one of them
SELECT
    code, product_name, brands, quantity, serving_quantity, last_modified_t, "energy-kcal_100g", energy_100g, fat_100g,
    carbohydrates_100g, proteins_100g, sodium_100g
FROM published LIMIT 1;

-- columns that only some dumps have are NULL in the others
CREATE TABLE optional (
    serving_size VARCHAR, countries_tags VARCHAR, nutrition_data_per VARCHAR, "energy-kj_100g" VARCHAR,
    "saturated-fat_100g" VARCHAR, sugars_100g VARCHAR, fiber_100g VARCHAR, salt_100g VARCHAR, alcohol_100g VARCHAR,
    polyols_100g VARCHAR, "energy-kcal_serving" VARCHAR, "energy-kj_serving" VARCHAR, energy_serving VARCHAR,
    fat_serving VARCHAR, "saturated-fat_serving" VARCHAR, carbohydrates_serving VARCHAR, sugars_serving VARCHAR,
    fiber_serving VARCHAR, proteins_serving VARCHAR, salt_serving VARCHAR, sodium_serving VARCHAR,
    alcohol_serving VARCHAR, polyols_serving VARCHAR
);

CREATE MACRO number(text) AS CASE WHEN isfinite(TRY_CAST(text AS DOUBLE)) THEN text::DOUBLE END;
CREATE MACRO line(text) AS nullif(trim(regexp_replace(text, '\s+', ' ', 'g')), '');
-- per_serving: the weight of the serving that a label's figures are of; NULL: they are of 100 g
CREATE MACRO per_100(per_serving, of_serving, of_100g) AS
    round(if(per_serving IS NULL, number(of_100g), number(of_serving) * 100 / per_serving), 4);

CREATE TABLE checked AS
WITH sizes AS (
    SELECT
        *,
        nutrition_data_per IS NOT DISTINCT FROM 'serving' AS is_per_serving,
        CASE WHEN number(serving_quantity) BETWEEN 0.5 AND 2000 THEN number(serving_quantity) END AS serving_g,
        regexp_extract(
            lower(quantity),
            '(?:(\d+)\s*[x×*]\s*)?(\d+(?:[.,]\d+)?)\s*(kg|gr|g|ml|cl|dl|l)\b',
            ['times', 'amount', 'unit']
        ) AS pack
    FROM (FROM optional UNION ALL BY NAME FROM published)
),
packs AS (
    SELECT
        *,
        if(is_per_serving, coalesce(serving_g, 'nan'), NULL) AS per_serving,
        -- 1.000 g has a separator of thousands, 1.000 kg a decimal point
        CASE
            WHEN pack.unit IN ('g', 'gr', 'ml') AND regexp_full_match(pack.amount, '\d{1,3}[.,]\d{3}')
                THEN TRY_CAST(regexp_replace(pack.amount, '[.,]', '') AS DOUBLE)
            ELSE TRY_CAST(replace(pack.amount, ',', '.') AS DOUBLE)
        END
        * coalesce(TRY_CAST(pack.times AS DOUBLE), 1)
        * CASE pack.unit WHEN 'kg' THEN 1000 WHEN 'l' THEN 1000 WHEN 'dl' THEN 100 WHEN 'cl' THEN 10 ELSE 1 END
            AS size_g,
        CASE
            WHEN pack.unit <> '' THEN pack.unit IN ('l', 'dl', 'cl', 'ml')
            ELSE regexp_matches(lower(coalesce(serving_size, '')), '\d\s*(ml|cl|dl|l)\b')
        END AS is_liquid,
        -- labels of the United States and Canada count fibre as carbohydrate, others do not
        coalesce(regexp_full_match(countries_tags, '(en:(united-states|canada),?)+'), FALSE) AS is_american,
        coalesce(regexp_matches(countries_tags, 'en:(united-states|canada)'), FALSE) AS is_american_too
    FROM sizes
),
labels AS (
    SELECT
        code,
        -- the check digit: from the right, the digits count once and three times in turn
        CASE
            WHEN regexp_full_match(code, '\d{8}|\d{12,14}')
            AND list_sum(
                [substr(lpad(code, 14, '0'), i, 1)::INT * (1 + 2 * (i % 2)) FOR i IN range(1, 15)]
            ) % 10 = 0
                THEN nullif(code::BIGINT, 0)
        END AS gtin,
        line(product_name) AS name,
        line(brands) AS brands,
        is_liquid,
        CASE WHEN size_g BETWEEN 1 AND 50000 THEN size_g END AS pack_g,
        serving_g,
        is_american,
        is_american_too,
        is_per_serving,
        NOT is_per_serving
        AND serving_g NOT BETWEEN 98 AND 102
        AND coalesce(
            number("energy-kcal_serving") = nullif(number("energy-kcal_100g"), 0),
            number(energy_serving) = nullif(number(energy_100g), 0)
        ) AS is_copied,
        number(last_modified_t) AS modified_at,
        per_100(per_serving, "energy-kcal_serving", "energy-kcal_100g") AS kcal,
        per_100(per_serving, "energy-kj_serving", "energy-kj_100g") AS kj,
        per_100(per_serving, energy_serving, energy_100g) AS energy,  -- kJ as well
        per_100(per_serving, proteins_serving, proteins_100g) AS protein,
        per_100(per_serving, fat_serving, fat_100g) AS fat,
        per_100(per_serving, "saturated-fat_serving", "saturated-fat_100g") AS saturated,
        per_100(per_serving, carbohydrates_serving, carbohydrates_100g) AS carbohydrate,
        per_100(per_serving, sugars_serving, sugars_100g) AS sugar,
        per_100(per_serving, fiber_serving, fiber_100g) AS fibre,
        per_100(per_serving, salt_serving, salt_100g) AS salt,
        per_100(per_serving, sodium_serving, sodium_100g) AS sodium,
        per_100(per_serving, alcohol_serving, alcohol_100g) AS alcohol,  -- % by volume
        per_100(per_serving, polyols_serving, polyols_100g) AS polyols
    FROM packs
),
energies AS (
    SELECT
        *,
        coalesce(kcal, kj / 4.184, energy / 4.184) AS energy_kcal,
        coalesce(sodium, salt / 2.5) AS sodium_g,
        -- the least and the most that 4, 9 and 4 kcal a gram allow: fibre and polyols may count or not
        4 * coalesce(protein, 0) + 9 * coalesce(fat, 0)
        + 4 * greatest(
            coalesce(carbohydrate, 0) - coalesce(polyols, 0) - if(is_american_too, coalesce(fibre, 0), 0), 0
        ) AS least_kcal,
        least(
            coalesce(
                4 * protein + 9 * fat + 4 * carbohydrate + 2 * coalesce(fibre, 0) + 5.6 * coalesce(alcohol, 0), 900
            ),
            900
        ) AS most_kcal
    FROM labels
)
SELECT
    code,
    gtin,
    left(concat_ws(', ', name, brands), 300) AS name,
    is_liquid,
    pack_g,
    serving_g,
    {
        '208': round(energy_kcal, 1),
        '203': protein,
        '204': fat,
        '606': saturated,
        '205': CASE WHEN is_american THEN carbohydrate WHEN NOT is_american_too THEN carbohydrate + fibre END,
        'CHOAVL': CASE
            WHEN NOT is_american_too THEN carbohydrate
            WHEN is_american AND carbohydrate >= fibre THEN carbohydrate - fibre
        END,
        '269': sugar,
        '291': fibre,
        '307': round(sodium_g * 1000, 1)
    } AS per_100_g,
    modified_at,
    CASE
        WHEN gtin IS NULL THEN 'whose code is no GTIN'
        WHEN name IS NULL THEN 'without a name'
        WHEN is_per_serving AND serving_g IS NULL THEN 'with figures of a serving of unknown weight'
        WHEN coalesce(energy_kcal, protein, fat, carbohydrate, sodium_g) IS NULL THEN 'without figures'
        WHEN least(energy_kcal, protein, fat, saturated, carbohydrate, sugar, fibre, sodium_g, salt) < 0
            THEN 'with a figure below zero'
        WHEN greatest(protein, fat, saturated, carbohydrate, sugar, fibre, sodium_g * 2.5, salt) > 100
            THEN 'with more than 100 g of a nutrient in 100 g'
        WHEN coalesce(protein, 0) + coalesce(fat, 0) + coalesce(carbohydrate, 0) + coalesce(sodium_g, 0) * 2.5 > 102
            THEN 'with nutrients of more than 100 g together'
        WHEN saturated > fat + 0.6 OR sugar > carbohydrate + 0.6 THEN 'with a part larger than its whole'
        WHEN is_copied THEN 'with figures of a serving under 100 g'
        WHEN energy_kcal > least(most_kcal * 1.2 + 5, 910)
        AND energy_kcal / 4.184 BETWEEN least_kcal * 0.9 - 1 AND most_kcal * 1.1 + 1
            THEN 'with kJ given as kcal'
        WHEN energy_kcal NOT BETWEEN least_kcal * 0.8 - 20 AND least(most_kcal * 1.2 + 20, 910)
            THEN 'with an energy that its nutrients do not have'
        WHEN abs(coalesce(kj, energy) - 4.184 * kcal) > 0.05 * coalesce(kj, energy) + 20
            THEN 'with different energies in kJ and kcal'
    END AS reason
FROM energies;

CREATE TABLE sound AS
SELECT gtin AS code, name, is_liquid, pack_g, serving_g, to_json(per_100_g)::VARCHAR AS per_100_g FROM checked
WHERE reason IS NULL
QUALIFY row_number() OVER (PARTITION BY gtin ORDER BY modified_at DESC) = 1;

CREATE VIEW refused AS
SELECT reason, count(*) AS rows, min(code, 5) AS examples FROM checked WHERE reason IS NOT NULL GROUP BY reason
UNION ALL
SELECT 'lines with other columns than the header', count(DISTINCT line), min('line ' || line, 5) FROM reject_errors
HAVING count(*) > 0
UNION ALL
SELECT 'older rows of a code', count(*) - count(DISTINCT gtin), [] FROM checked WHERE reason IS NULL
HAVING count(*) > count(DISTINCT gtin);

CREATE VIEW figures AS
SELECT
    count(*) AS rows,
    (9 * count(*) - sum(len(regexp_extract_all(per_100_g, 'null'))))::BIGINT AS contents,
    (SELECT max(modified_at) FROM checked WHERE reason IS NULL) AS modified_at
FROM sound;

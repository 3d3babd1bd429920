-- The foods of the frozen items (view `used`), their nutrients, and the densities that may have weighed them.
CREATE TEMP VIEW release_foods AS
SELECT
    used.food_key,
    used.food_version,
    used.food_table,
    food.id AS food_id,
    food.name,
    food.food_group,
    food.state,
    food.is_mixed_dish::BOOLEAN AS is_mixed_dish
FROM used
JOIN food ON food.key = used.food_key AND food.version = used.food_version
JOIN food_release ON food_release.id = food.release_id
    AND food_release.name || ' ' || food_release.version = used.food_table;

CREATE TEMP VIEW release_food_nutrients AS
SELECT
    foods.food_key,
    foods.food_version,
    foods.food_table,
    component.number,
    component.tagname,
    component.name AS component,
    component.unit,
    food_nutrient.per_100_g
FROM release_foods foods
JOIN food_nutrient ON food_nutrient.food_id = foods.food_id
JOIN component ON component.id = food_nutrient.component_id;

CREATE TEMP VIEW release_food_densities AS
SELECT
    foods.food_key,
    foods.food_version,
    foods.food_table,
    'table' AS measured_by,
    density.g_per_ml,
    density.sd_g_per_ml,
    density.state,
    density.kind,
    density.basis,
    density.weighs,
    density.source,
    false AS is_of_study,
    density.position AS place,
    NULL AS measured_at,
    '' AS id
FROM release_foods foods
JOIN food_density density ON density.food_id = foods.food_id
UNION ALL
SELECT
    density.food_key,
    NULL,
    NULL,
    'study',
    density.g_per_ml,
    density.sd_g_per_ml,
    density.state,
    density.kind,
    NULL,
    density.weighs,
    density.source,
    true,
    0,
    as_utc(density.measured_at),
    id_text(density.id)
FROM study_density density
WHERE density.withdrawn_at IS NULL
    AND id_text(density.study_id) = getvariable('study_id')
    AND density.food_key IN (SELECT food_key FROM release_foods);

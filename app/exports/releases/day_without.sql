-- The days of a release from which a meal was erased, computed from its remaining meals and items alone.
-- Given: before (the days' rows), meals_left, meals_gone, items_left, and the variable expects_after_pair.
-- The study day is kept. If a day's only meal is gone, what was eaten is unknown, never 0; a day without a decision
-- about it is gone with its only meal.
WITH changed AS (
    SELECT DISTINCT participant, local_date FROM meals_gone
),
arrived AS (
    SELECT
        participant,
        local_date,
        is_left,
        row_number() OVER (PARTITION BY participant, local_date ORDER BY received_at DESC, is_left DESC) AS place
    FROM (
        SELECT participant, local_date, received_at, true AS is_left FROM meals_left
        UNION ALL
        SELECT participant, local_date, received_at, false FROM meals_gone
    )
),
late AS (
    SELECT participant, local_date, count(*) FILTER (is_left AND place <= before.meals_after_closing) AS meals
    FROM arrived JOIN before USING (participant, local_date)
    GROUP BY participant, local_date
),
held AS (
    SELECT * FROM items_left WHERE status <> 'rejected'
),
of_meals AS (
    SELECT
        participant,
        local_date,
        count(*) AS meals,
        median_of(upload_delay_seconds) AS median_upload_delay_seconds,
        count(*) FILTER (
            status <> 'confirmed' AND (participant, meal_id) NOT IN (SELECT participant, meal_id FROM held)
        ) AS unmeasured_meals
    FROM meals_left
    GROUP BY participant, local_date
),
of_items AS (
    SELECT
        record.participant,
        record.local_date,
        count(*) AS items,
        count(*) - count(record.consumed_g) AS unmeasured_items,
        count(*) FILTER (record.provisional) AS provisional_items,
        count(*) FILTER (
            getvariable('expects_after_pair')
            AND meals_left.origin = 'photographed'
            AND record.origin IN ('pipeline', 'added', 'split', 'merged')
            AND record.consumed_g IS NOT NULL
            AND record.left_g IS NULL
        ) AS leftovers_unknown_items,
        sum_of(record.consumed_g) AS consumed_g,
        sum_of(record.{headline}) AS {headline},
        coverage_of(record.{headline}, record.consumed_g) AS {headline}_coverage,
    FROM held record
    JOIN meals_left USING (participant, meal_id)
    GROUP BY record.participant, record.local_date
),
counted AS (
    SELECT
        changed.participant,
        changed.local_date,
        coalesce(of_meals.meals, 0) AS meals,
        coalesce(late.meals, 0) AS meals_after_closing,
        of_meals.median_upload_delay_seconds,
        coalesce(of_items.items, 0) AS items,
        coalesce(of_meals.unmeasured_meals, 0) AS unmeasured_meals,
        coalesce(of_items.unmeasured_items, 0) AS unmeasured_items,
        coalesce(of_items.provisional_items, 0) AS provisional_items,
        coalesce(of_items.leftovers_unknown_items, 0) AS leftovers_unknown_items,
        of_items.consumed_g,
        of_items.{headline},
        of_items.{headline}_coverage,
    FROM changed
    LEFT JOIN late USING (participant, local_date)
    LEFT JOIN of_meals USING (participant, local_date)
    LEFT JOIN of_items USING (participant, local_date)
),
judged AS (
    SELECT
        *,
        meals > 0 AND day_status = 'closed' AND items = 0 AND unmeasured_meals = 0 AS is_nothing
    FROM counted JOIN (SELECT participant, local_date, day_status, decided_by FROM before)
        USING (participant, local_date)
    WHERE meals > 0 OR decided_by IS NOT NULL
)
SELECT
    participant,
    local_date,
    meals,
    meals_after_closing,
    median_upload_delay_seconds,
    items,
    unmeasured_meals,
    unmeasured_items,
    provisional_items,
    leftovers_unknown_items,
    CASE WHEN is_nothing THEN 0.0 ELSE consumed_g END AS consumed_g,
    CASE WHEN is_nothing THEN 0.0 ELSE {headline} END AS {headline},
    CASE WHEN is_nothing THEN 1.0 WHEN unmeasured_meals = 0 THEN {headline}_coverage END AS {headline}_coverage,
FROM judged

-- One view per table that leaves the server: its columns are those of the data dictionary (columns.py).
-- The last columns of a view, from study_id on, serve filters and order, and are not exported.

CREATE MACRO instant(stored) AS as_utc(stored) AT TIME ZONE 'UTC';
CREATE MACRO local_time(stored, offset_minutes) AS as_utc(stored) + to_minutes(offset_minutes);
CREATE MACRO seconds_between(earlier, later) AS (epoch_us(later) - epoch_us(earlier)) / 1e6;
-- Where a meal was eaten: both numbers or none, and none if the study keeps no places any longer.
CREATE MACRO stored_place(details, name) AS (details::JSON -> 'location' ->> name)::DOUBLE;
CREATE MACRO place_of(policy, details, name) AS
    CASE WHEN policy <> 'drop' AND stored_place(details, 'longitude') IS NOT NULL
        AND stored_place(details, 'latitude') IS NOT NULL THEN stored_place(details, name) END;
-- A confirmed meal without records: nothing was eaten of anything.
CREATE MACRO nothing_or(status, items, amount, nothing) AS
    CASE WHEN items IS NULL AND status = 'confirmed' THEN nothing ELSE amount END;

CREATE VIEW first_days AS
SELECT participant.id AS participant_id, coalesce(starts_on, least(of_meals.first, of_closed.first)) AS first_day
FROM participant
LEFT JOIN (SELECT participant_id, min(local_date) AS first FROM meal GROUP BY participant_id) of_meals
    ON of_meals.participant_id = participant.id
LEFT JOIN (
    SELECT participant_id, min(local_date) AS first FROM diary_day WHERE status = 'closed' GROUP BY participant_id
) of_closed ON of_closed.participant_id = participant.id;

-- A row an item of a meal, as it stands after all reviews.
CREATE VIEW records AS
SELECT
    id_text(record.item_id) AS id,
    id_text(meal.client_id) AS meal_id,
    study.code AS study,
    participant.code AS participant,
    instant(record.captured_at) AS captured_at,
    local_time(record.captured_at, meal.utc_offset_minutes) AS captured_local,
    meal.time_zone,
    record.local_date,
    seconds_between(meal.captured_at, meal.received_at) AS upload_delay_seconds,
    record.status,
    record.origin,
    record.provisional::BOOLEAN AS provisional,
    record.reviewed::BOOLEAN AS reviewed,
    food.key AS food_key,
    food.name AS food_name,
    food_release.name || ' ' || food_release.version AS food_table,
    record.volume_ml,
    record.volume_low_ml,
    record.volume_high_ml,
    record.density_g_per_ml,
    record.density_source,
    record.mass_g,
    record.mass_low_g,
    record.mass_high_g,
    record.edible_g,
    record.share,
    record.left_g,
    record.consumed_g,
    record.consumed_low_g,
    record.consumed_high_g,
    record.{headline},
    words(record.flags) AS flags,
    record.change_seq,
    coalesce(diary_day.status, 'open') AS day_status,
    date_diff('day', first_days.first_day, record.local_date) + 1 AS study_day,
    food.version AS food_version,
    id_text(record.run_id) AS run_id,
    run.method,
    run.pipeline_version,
    item_food.layer AS food_said_by,
    CASE WHEN record.density_g_per_ml IS NOT NULL THEN item_food.density_basis END AS density_basis,
    CASE WHEN record.density_g_per_ml IS NOT NULL THEN item_food.density_sd_g_per_ml END AS density_sd_g_per_ml,
    item_food.edible_share,
    record.doubt,
    id_text(record.study_id) AS study_id,
    id_text(record.participant_id) AS participant_id,
    record.food_id,
    record.item_id AS place_in_order,
    record.meal_id AS meal_key,
    place_of(study.location_policy, meal.details, 'longitude') AS longitude,
    place_of(study.location_policy, meal.details, 'latitude') AS latitude
FROM effective_record record
JOIN meal ON meal.id = record.meal_id
JOIN study ON study.id = record.study_id
JOIN participant ON participant.id = record.participant_id
LEFT JOIN first_days ON first_days.participant_id = record.participant_id
LEFT JOIN diary_day
    ON diary_day.participant_id = record.participant_id AND diary_day.local_date = record.local_date
LEFT JOIN food ON food.id = record.food_id
LEFT JOIN food_release ON food_release.id = food.release_id
LEFT JOIN run ON run.id = record.run_id
LEFT JOIN item_food ON item_food.item_id = record.item_id AND item_food.version = record.food_version;

-- The components of the food table in what was eaten: a row a record and component that its food has.
CREATE VIEW components AS
SELECT
    records.id,
    records.meal_id,
    records.study,
    records.participant,
    records.captured_at,
    records.local_date,
    records.status,
    records.food_key,
    records.food_name,
    component.number,
    component.tagname,
    component.name AS component_name,
    component.unit,
    records.consumed_g * (food_nutrient.per_100_g / 100.0) AS amount,
    food_nutrient.per_100_g,
    records.study_id
FROM main.records
JOIN food_nutrient ON food_nutrient.food_id = records.food_id
JOIN component ON component.id = food_nutrient.component_id;

CREATE VIEW foods_of_records AS
SELECT DISTINCT food_id, id_text(study_id) AS study_id FROM effective_record WHERE food_id IS NOT NULL;

-- What the records of a meal that hold come to.
CREATE VIEW sums_of_meals AS
SELECT
    record.meal_id,
    bool_or(record.provisional::BOOLEAN) AS provisional,
    count(*) AS items,
    count(*) - count(record.consumed_g) AS unmeasured_items,
    count(*) FILTER (
        NOT record.reviewed::BOOLEAN AND (record.origin <> 'declared' OR record.status = 'needs_review')
    ) AS unreviewed_items,
    max(record.doubt) AS doubt,
    sum_of(record.consumed_g) AS consumed_g,
    sum_of(record.{headline}) AS {headline},
    coverage_of(record.{headline}, record.consumed_g) AS {headline}_coverage,
FROM effective_record record
WHERE record.status <> 'rejected'
GROUP BY record.meal_id;

-- Their foods and flags, in the order of the items. Lists take their members as they come: an order of their own
-- would take a buffer for each meal.
CREATE VIEW words_of_meals AS
SELECT
    meal_id,
    without_repeats(list(food_key) FILTER (food_key IS NOT NULL)) AS food_keys,
    without_repeats(flatten(list(flags))) AS flags
FROM (
    SELECT record.meal_id, food.key AS food_key, words(record.flags) AS flags
    FROM effective_record record
    JOIN item ON item.id = record.item_id
    LEFT JOIN food ON food.id = record.food_id
    WHERE record.status <> 'rejected'
    ORDER BY record.meal_id, item.position, item.id
)
GROUP BY meal_id;

CREATE VIEW photographs_of_pairs AS
SELECT
    meal_id,
    max(received_sha256) FILTER (slot = 'left') AS left_received_sha256,
    max(stored_sha256) FILTER (slot = 'left') AS left_stored_sha256,
    max(received_sha256) FILTER (slot = 'right') AS right_received_sha256,
    max(stored_sha256) FILTER (slot = 'right') AS right_stored_sha256
FROM meal_image
GROUP BY meal_id;

CREATE VIEW newest_runs AS
SELECT * FROM run WHERE purpose = 'meal'
QUALIFY row_number() OVER (PARTITION BY meal_id ORDER BY created_at DESC, id) = 1;

-- A row a meal.
CREATE VIEW meals AS
SELECT
    id_text(meal.client_id) AS meal_id,
    study.code AS study,
    participant.code AS participant,
    instant(meal.captured_at) AS captured_at,
    local_time(meal.captured_at, meal.utc_offset_minutes) AS captured_local,
    meal.time_zone,
    meal.local_date,
    instant(meal.received_at) AS received_at,
    seconds_between(meal.captured_at, meal.received_at) AS upload_delay_seconds,
    coalesce(diary_day.status, 'open') AS day_status,
    date_diff('day', first_days.first_day, meal.local_date) + 1 AS study_day,
    meal.status,
    meal.origin,
    meal.failure_code,
    meal.after_status,
    coalesce(sums.provisional, false) AS provisional,
    coalesce(words.food_keys, []) AS food_keys,
    coalesce(words.flags, []) AS flags,
    coalesce(sums.items, 0) AS items,
    coalesce(sums.unmeasured_items, 0) AS unmeasured_items,
    coalesce(sums.unreviewed_items, 0) AS unreviewed_items,
    sums.doubt,
    meal.version,
    nothing_or(meal.status, sums.items, sums.consumed_g, 0.0) AS consumed_g,
    nothing_or(meal.status, sums.items, sums.{headline}, 0.0) AS {headline},
    nothing_or(meal.status, sums.items, sums.{headline}_coverage, 1.0) AS {headline}_coverage,
    id_text(run.id) AS run_id,
    run.method,
    run.pipeline_version,
    run.marker,
    array_to_string(from_json(run.food_releases::JSON, '["VARCHAR"]'), '; ') AS food_tables,
    photographs.left_received_sha256,
    photographs.left_stored_sha256,
    photographs.right_received_sha256,
    photographs.right_stored_sha256,
    place_of(study.location_policy, meal.details, 'longitude') AS longitude,
    place_of(study.location_policy, meal.details, 'latitude') AS latitude,
    id_text(meal.study_id) AS study_id,
    id_text(meal.participant_id) AS participant_id,
    meal.id AS place_in_order,
    meal.id AS meal_key,
    sums.items IS NULL AND meal.status = 'confirmed' AS is_nothing,
    false AS is_partial
FROM meal
JOIN study ON study.id = meal.study_id
JOIN participant ON participant.id = meal.participant_id
LEFT JOIN first_days ON first_days.participant_id = meal.participant_id
LEFT JOIN diary_day ON diary_day.participant_id = meal.participant_id AND diary_day.local_date = meal.local_date
LEFT JOIN sums_of_meals sums ON sums.meal_id = meal.id
LEFT JOIN words_of_meals words ON words.meal_id = meal.id
LEFT JOIN newest_runs run ON run.meal_id = meal.id
LEFT JOIN photographs_of_pairs photographs ON photographs.meal_id = meal.id;

-- Events that were taken back, and answers that were not.
CREATE VIEW undone_events AS
SELECT meal_id, new::JSON ->> 'event' AS id FROM meal_event WHERE kind = 'undo';
CREATE VIEW answers AS
SELECT meal_id, new::JSON ->> 'question' AS question FROM meal_event
WHERE kind = 'answer' AND id_text(id) NOT IN (SELECT id FROM undone_events WHERE id IS NOT NULL);

-- Meals with a question to the participant that is neither answered nor taken back.
CREATE VIEW open_questions AS
SELECT DISTINCT meal_id FROM meal_event
WHERE kind = 'question'
    AND id_text(id) NOT IN (SELECT id FROM undone_events WHERE id IS NOT NULL)
    AND id_text(id) NOT IN (SELECT question FROM answers WHERE question IS NOT NULL);

-- A row a photograph, depth map or voice note.
CREATE VIEW photographs AS
SELECT
    id_text(meal.client_id) AS meal_id,
    study.code AS study,
    participant.code AS participant,
    instant(meal.captured_at) AS captured_at,
    local_time(meal.captured_at, meal.utc_offset_minutes) AS captured_local,
    meal.local_date,
    image.slot,
    image.media_type,
    image.width_px,
    image.height_px,
    image.bytes,
    image.received_sha256,
    image.stored_sha256,
    instant(image.received_at) AS received_at,
    image.erased_at IS NOT NULL AS erased,
    instant(image.erased_at) AS erased_at,
    CASE WHEN image.erased_at IS NULL THEN
        '/v1/meals/' || id_text(meal.client_id) || '/images/' || image.slot
            || '?participant=' || url_encode(participant.code) END AS path,
    id_text(meal.study_id) AS study_id,
    id_text(meal.participant_id) AS participant_id,
    meal.id AS place_in_order,
    list_position({slots}, image.slot) AS place_of_slot
FROM meal_image image
JOIN meal ON meal.id = image.meal_id
JOIN study ON study.id = meal.study_id
JOIN participant ON participant.id = meal.participant_id;

-- A row a participant, with those who have left.
CREATE VIEW participants AS
SELECT
    study.code AS study,
    participant.code AS participant,
    participant.profile::JSON ->> 'sex' AS sex,
    year(coalesce(first_days.first_day, as_utc(phones.enrolled_at)::DATE))
        - (participant.profile::JSON ->> 'birth_year')::BIGINT AS age_years,
    (participant.profile::JSON ->> 'height_cm')::DOUBLE AS height_cm,
    (participant.profile::JSON ->> 'weight_kg')::DOUBLE AS weight_kg,
    participant.profile::JSON ->> 'activity' AS activity,
    (participant.profile::JSON ->> 'is_pregnant')::BOOLEAN AS is_pregnant,
    (participant.profile::JSON ->> 'trimester')::BIGINT AS trimester,
    (participant.profile::JSON ->> 'is_lactating')::BOOLEAN AS is_lactating,
    (participant.profile::JSON ->> 'lactation_months')::BIGINT AS lactation_months,
    participant.starts_on,
    participant.arm,
    participant.visit,
    participant.excluded,
    instant(phones.enrolled_at) AS enrolled_at,
    instant(participant.withdrawn_at) AS withdrawn_at,
    coalesce(of_meals.meals, 0) AS meals,
    of_meals.first_meal_on,
    of_meals.last_meal_on,
    id_text(participant.study_id) AS study_id,
    id_text(participant.id) AS participant_id
FROM participant
JOIN study ON study.id = participant.study_id
LEFT JOIN first_days ON first_days.participant_id = participant.id
LEFT JOIN (SELECT participant_id, min(enrolled_at) AS enrolled_at FROM device GROUP BY participant_id) phones
    ON phones.participant_id = participant.id
LEFT JOIN (
    SELECT participant_id, count(*) AS meals, min(local_date) AS first_meal_on, max(local_date) AS last_meal_on
    FROM meal GROUP BY participant_id
) of_meals ON of_meals.participant_id = participant.id;

-- What the meals of a day, and their records that hold, come to.
CREATE VIEW meals_of_days AS
SELECT
    meal.participant_id,
    meal.local_date,
    count(*) AS meals,
    count(*) FILTER (diary_day.status = 'closed' AND meal.received_at > diary_day.changed_at) AS meals_after_closing,
    count(*) FILTER (
        meal.status <> 'confirmed'
        AND meal.id NOT IN (SELECT meal_id FROM effective_record WHERE status <> 'rejected')
    ) AS unmeasured_meals,
    median_of(seconds_between(meal.captured_at, meal.received_at)) AS median_upload_delay_seconds
FROM meal
LEFT JOIN diary_day ON diary_day.participant_id = meal.participant_id AND diary_day.local_date = meal.local_date
GROUP BY meal.participant_id, meal.local_date;

CREATE VIEW records_of_days AS
SELECT
    record.participant_id,
    record.local_date,
    count(*) AS items,
    count(*) - count(record.consumed_g) AS unmeasured_items,
    count(*) FILTER (record.provisional::BOOLEAN) AS provisional_items,
    count(*) FILTER (
        meal.origin = 'photographed'
        AND record.origin IN ('pipeline', 'added', 'split', 'merged')
        AND record.consumed_g IS NOT NULL
        AND record.left_g IS NULL
    ) AS unseen_leftovers_items,
    sum_of(record.consumed_g) AS consumed_g,
    sum_of(record.{headline}) AS {headline},
    coverage_of(record.{headline}, record.consumed_g) AS {headline}_coverage,
FROM effective_record record
JOIN meal ON meal.id = record.meal_id
WHERE record.status <> 'rejected'
GROUP BY record.participant_id, record.local_date;

CREATE VIEW counted_days AS
SELECT
    day.participant_id,
    day.local_date,
    coalesce(diary_day.status, 'open') AS status,
    diary_day.version IS NOT NULL AS has_entry,
    coalesce(meals, 0) AS meals,
    coalesce(meals_after_closing, 0) AS meals_after_closing,
    coalesce(unmeasured_meals, 0) AS unmeasured_meals,
    median_upload_delay_seconds,
    coalesce(items, 0) AS items,
    coalesce(unmeasured_items, 0) AS unmeasured_items,
    coalesce(provisional_items, 0) AS provisional_items,
    coalesce(unseen_leftovers_items, 0) AS unseen_leftovers_items,
    coalesce(diary_day.status = 'closed' AND diary_day.ate_nothing::BOOLEAN AND meals IS NULL, false) AS said_nothing,
    said_nothing OR coalesce(
        diary_day.status = 'closed' AND meals > 0 AND items IS NULL AND unmeasured_meals = 0, false
    ) AS is_nothing,
    consumed_g,
    {headline},
    CASE WHEN coalesce(unmeasured_meals, 0) = 0 THEN {headline}_coverage END AS {headline}_coverage,
FROM (
    SELECT participant_id, local_date FROM meal UNION SELECT participant_id, local_date FROM diary_day
) day
LEFT JOIN diary_day ON diary_day.participant_id = day.participant_id AND diary_day.local_date = day.local_date
LEFT JOIN meals_of_days ON meals_of_days.participant_id = day.participant_id
    AND meals_of_days.local_date = day.local_date
LEFT JOIN records_of_days ON records_of_days.participant_id = day.participant_id
    AND records_of_days.local_date = day.local_date;

-- A row a participant's day that has a meal or a diary entry.
CREATE VIEW days AS
SELECT
    study.code AS study,
    participant.code AS participant,
    day.local_date,
    date_diff('day', first_days.first_day, day.local_date) + 1 AS study_day,
    day.status AS day_status,
    day.said_nothing AS ate_nothing,
    CASE WHEN NOT day.has_entry THEN NULL
        WHEN (day.participant_id, day.local_date) IN (
            SELECT participant_id, local_date FROM day_event WHERE layer = 'reviewer'
        ) THEN 'reviewer'
        ELSE 'participant' END AS decided_by,
    day.meals,
    day.meals_after_closing,
    day.median_upload_delay_seconds,
    day.items,
    day.unmeasured_meals,
    day.unmeasured_items,
    day.provisional_items,
    CASE WHEN study.expects_after_pair::BOOLEAN THEN day.unseen_leftovers_items ELSE 0 END AS leftovers_unknown_items,
    CASE WHEN day.is_nothing THEN 0.0 ELSE day.consumed_g END AS consumed_g,
    CASE WHEN day.is_nothing THEN 0.0 ELSE day.{headline} END AS {headline},
    CASE WHEN day.is_nothing THEN 1.0 ELSE day.{headline}_coverage END AS {headline}_coverage,
    day.is_nothing OR (
        day.status = 'closed' AND day.items > 0 AND day.unmeasured_items = 0 AND day.unmeasured_meals = 0
        AND day.provisional_items = 0
    ) AS is_complete,
    CASE WHEN day.is_nothing THEN 0.0
        WHEN is_complete AND day.energy_kcal_coverage >= 1.0 - 1e-9 THEN day.energy_kcal END AS whole_energy_kcal,
    energy_to_basal_rate(participant.profile::VARCHAR, day.local_date::VARCHAR, whole_energy_kcal)
        AS energy_to_basal_rate,
    plausibility(participant.profile::VARCHAR, day.local_date::VARCHAR, whole_energy_kcal) AS plausibility,
    id_text(participant.study_id) AS study_id,
    id_text(day.participant_id) AS participant_id,
    day.participant_id AS place_in_order,
    day.is_nothing,
    day.unmeasured_meals > 0 AS is_partial
FROM counted_days day
JOIN participant ON participant.id = day.participant_id
JOIN study ON study.id = participant.study_id
LEFT JOIN first_days ON first_days.participant_id = day.participant_id;

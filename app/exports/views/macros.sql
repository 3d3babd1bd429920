-- What the views, and the files of a release, have in common.

-- A list of words, stored as JSON: no word has a blank, a comma, a bracket or a quotation mark.
CREATE MACRO words(stored) AS
    CASE WHEN stored::VARCHAR IN ('[]', '[ ]') THEN []::VARCHAR[]
    ELSE string_split(translate(stored::VARCHAR, '[]", ', '    ').trim().regexp_replace(' +', ' ', 'g'), ' ') END;
CREATE MACRO without_repeats(list) AS list_filter(list, lambda word, place: list_position(list, word) = place);
-- Sums of whole billionths: the same in whatever order they are added, in every database.
CREATE MACRO billionths(amount) AS trunc(amount * 1e9 + 0.5 * sign(amount))::HUGEINT;
CREATE MACRO sum_of(amount) AS sum(billionths(amount))::DOUBLE / 1e9;
CREATE MACRO weight_of(consumed_g) AS CASE WHEN consumed_g > 0 THEN consumed_g ELSE 0.0 END;
-- The share of the eaten grams for which the amount is known.
CREATE MACRO coverage_of(amount, consumed_g) AS
    CASE WHEN count(*) = count(consumed_g) THEN coalesce(
        sum_of(CASE WHEN amount IS NULL THEN 0.0 ELSE weight_of(consumed_g) END)
            / nullif(sum_of(weight_of(consumed_g)), 0.0),
        CASE WHEN count(amount) = count(*) THEN 1.0 ELSE 0.0 END) END;
CREATE MACRO median_of(seconds) AS
    (list_sort(list(seconds))[(count(seconds) + 1) // 2] + list_sort(list(seconds))[count(seconds) // 2 + 1]) / 2;

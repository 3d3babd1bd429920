import math
from dataclasses import replace

import numpy as np
import pytest

from app.identification.examples import Example, Examples, NumberedIndex
from app.identification.habits import EQUAL_WEIGHT, NEW_FOODS, NEW_OF, STUDY_WEIGHT, Eaten
from app.identification.identifier import MOST_CANDIDATES, Circumstances, Identifier
from tests.unit.identification.small_index import LENGTH, LOOKS, pictures_of, small_index

NEW_LOOK = "tofu"  # none of the index


def learned(look: str, count: int, food_key: str | None = None, **more) -> list[Example]:
    """Confirmed items of a food, the newest last."""
    return [
        Example(name=f"{look} {number}", food_key=food_key or f"{look}-raw", vector=vector, **more)
        for number, vector in enumerate(pictures_of(look, count, seed=1))
    ]


def identifier_of(index, own=(), others=(), **more) -> Identifier:
    numbered = NumberedIndex(index)
    sets = []
    for examples in (own, others):
        sets.append(Examples(numbered))
        sets[-1].put(examples)
    return Identifier(numbered, sets[0], sets[1:], **more)


def asked(look: str, seed: int = 7) -> np.ndarray:
    return pictures_of(look, 1, seed=seed)[0]


def keys(found) -> list[str]:
    return [candidate.food_key for candidate in found.candidates]


def test_shipped_food_is_found_by_name_and_label_and_probabilities_add_up_to_1_with_none():
    best = identifier_of(small_index()).identify(asked("egg")).candidates[0]
    assert (best.name, best.label, best.food_key) == ("Egg", "egg", "egg-raw")
    assert best.probability > 0.6
    found = identifier_of(small_index(), learned(NEW_LOOK, 3)).identify(asked("bun"))
    probabilities = [candidate.probability for candidate in found.candidates]
    assert probabilities == sorted(probabilities, reverse=True)
    assert len(probabilities) == 5
    assert sum(probabilities) + found.none_probability == pytest.approx(1.0)


def test_sixth_of_a_new_food_is_found_after_five_confirmed_and_known_ones_still_are():
    identifier = identifier_of(small_index(), learned(NEW_LOOK, 5) + learned("yam", 40))
    for seed in range(7, 17):
        found = identifier.identify(asked(NEW_LOOK, seed))
        assert keys(found)[0] == "tofu-raw"
    assert (found.candidates[0].name, found.candidates[0].label) == (None, None)
    for look in LOOKS[:4]:
        assert keys(identifier.identify(asked(look)))[0] == f"{look}-raw"
    assert "tofu-raw" in keys(identifier_of(small_index(), learned(NEW_LOOK, 1)).identify(asked(NEW_LOOK)))[:3]


def test_confirmed_items_of_a_shipped_food_join_it():
    other_variety = learned("kale", 5, food_key="apple-raw")
    found = identifier_of(small_index(), other_variety).identify(asked("kale"))
    assert (found.candidates[0].food_key, found.candidates[0].label) == ("apple-raw", "apple")
    assert len(found.candidates) == 4


def test_volume_decides_between_foods_that_look_alike():
    alike = learned("tofu", 6, food_key="small", volume_ml=20.0) + learned("tofu", 6, food_key="large", volume_ml=500.0)
    alike = [replace(one, name=f"{one.food_key} {one.name}") for one in alike]
    identifier = identifier_of(small_index(), alike)
    assert keys(identifier.identify(asked("tofu"), Circumstances(volume_ml=22.0)))[0] == "small"
    assert keys(identifier.identify(asked("tofu"), Circumstances(volume_ml=480.0)))[0] == "large"
    small, large = sorted(
        (each for each in identifier.identify(asked("tofu")).candidates if each.food_key in {"small", "large"}),
        key=lambda each: each.food_key,
    )
    assert small.probability == pytest.approx(large.probability, rel=0.2)


@pytest.mark.parametrize("volume_ml", [None, 0.0, -1.0, math.nan, math.inf])
def test_volume_that_is_none_changes_nothing(volume_ml):
    identifier = identifier_of(small_index(volumes_ml={"egg": (50.0, 60.0)}))
    told = identifier.identify(asked("egg"), Circumstances(volume_ml=volume_ml, volume_relative_sd=math.nan))
    assert told == identifier.identify(asked("egg"))


def test_what_somebody_has_confirmed_counts_once_for_them_and_as_much_for_another():
    identifier = identifier_of(small_index(), learned("egg", 40, eater="me"))

    def odds(**known):
        found = identifier.identify(asked("yam"), Circumstances(day_minute=720, **known))
        of = {each.food_key: each.probability for each in found.candidates}
        return of["egg-raw"] / of["bun-raw"]

    by_looks = odds(eater="me")
    own = [Eaten("egg-raw", 720)] * 40
    by_hand = (40 + STUDY_WEIGHT / 4) / (STUDY_WEIGHT / 4)
    assert odds(eater="me", own=own) / by_looks == pytest.approx(by_hand)
    assert odds(eater="you") / by_looks == pytest.approx((40 + EQUAL_WEIGHT / 4) / (EQUAL_WEIGHT / 4))


def test_study_that_confirms_known_foods_or_those_of_another_study_meets_new_ones_less():
    def none_prior(*examples):
        return identifier_of(small_index(), *examples)._none_prior

    once = learned("tofu", 1)
    of_others = [replace(one, name=f"their {one.name}") for one in once]
    curious = [replace(one, food_key=f"new {one.name}") for one in learned("rice", 60)]
    assert none_prior() == NEW_FOODS / NEW_OF
    assert none_prior(learned("egg", 60)) == pytest.approx(NEW_FOODS / (60 + NEW_OF))
    assert none_prior(curious) == pytest.approx((60 + NEW_FOODS) / (60 + NEW_OF))
    assert none_prior(once) == pytest.approx((1 + NEW_FOODS) / (1 + NEW_OF))
    assert none_prior(once, of_others) == pytest.approx(NEW_FOODS / (1 + NEW_OF))
    settled, fresh = identifier_of(small_index(), learned("egg", 60)), identifier_of(small_index())
    assert settled.identify(asked("yam")).none_probability < fresh.identify(asked("yam")).none_probability


def test_version_changes_with_each_confirmed_item_and_with_what_it_says():
    index, examples = small_index(), learned("tofu", 3)
    versions = [identifier_of(index, examples[:count]).version for count in range(4)]
    changes = [{"volume_ml": 9.0}, {"food_key": "yam-raw"}, {"day_minute": 5}, {"name": "another"}]
    changes += [{"eater": "another"}]
    for change in [*changes, {"vector": asked("yam")}]:
        versions += [identifier_of(index, [*examples[:2], replace(examples[2], **change)]).version]
    versions += [identifier_of(index, examples[:2], examples[2:]).version]
    assert len(set(versions)) == len(versions)
    assert versions[0] == index.version
    assert all(version.startswith(index.version) for version in versions)


@pytest.mark.parametrize("bad", [np.zeros(LENGTH - 1), np.zeros(1), np.full(LENGTH, np.inf)])
def test_vector_of_another_length_or_of_no_numbers_raises(bad):
    with pytest.raises(ValueError, match=r"numbers|finite|dimension"):
        identifier_of(small_index()).identify(bad)
    with pytest.raises(ValueError, match=r"numbers|finite|dimension"):
        identifier_of(small_index(), [Example("bad", "bad", bad)])


def test_candidate_tells_by_how_many_pieces_it_is_known():
    identifier = identifier_of(small_index(), learned("egg", 3) + learned(NEW_LOOK, 2))
    known_by = {one.food_key: one.specimens for one in identifier.identify(asked("egg")).candidates}
    assert known_by == {"egg-raw": 13, "tofu-raw": 2, "apple-raw": 10, "bun-raw": 10, "plum-raw": 10}


# ---- examples that change in place


def test_examples_that_were_changed_and_removed_in_place_answer_as_those_that_never_were_there():
    index = small_index()
    numbered = NumberedIndex(index)
    kept = learned("tofu", 3, volume_ml=50.0) + learned("egg", 5, eater="me")
    changed = [replace(one, food_key="kale-raw", vector=asked("kale", 3)) for one in kept]
    examples = Examples(numbered)
    examples.put(learned("yam", 4))
    examples.put(changed)
    examples.take(one.name for one in kept)
    examples.put(kept)
    examples.take([f"yam {number}" for number in range(5)])
    assert sorted(examples.names) == sorted(one.name for one in kept)
    assert_same(Identifier(numbered, examples), identifier_of(index, kept))
    left_out = examples.take(["tofu 0", "egg 4", "nobody"])
    assert_same(Identifier(numbered, examples), identifier_of(index, kept[1:-1]))
    examples.append(*left_out)
    assert_same(Identifier(numbered, examples), identifier_of(index, kept))


def assert_same(told: Identifier, expected: Identifier) -> None:
    assert told.version == expected.version
    mine = Circumstances(volume_ml=60.0, eater="me")
    for look in ("tofu", "egg"):
        told_of, expected_of = told.identify(asked(look), mine), expected.identify(asked(look), mine)
        assert keys(told_of) == keys(expected_of)
        assert [one.specimens for one in told_of.candidates] == [one.specimens for one in expected_of.candidates]
        assert [one.probability for one in told_of.candidates] == pytest.approx(
            [one.probability for one in expected_of.candidates]
        )
        assert told_of.none_probability == pytest.approx(expected_of.none_probability)


def test_food_is_found_among_thousands_of_examples_and_of_them_the_likeliest_are_told():
    crowd = [
        Example(f"{look} {number}", f"{look} {number % 100}", vector)
        for look in ("rice", "kale", "yam")
        for number, vector in enumerate(pictures_of(look, 1000, seed=3))
    ]
    found = identifier_of(small_index(), crowd + learned(NEW_LOOK, 5)).identify(asked(NEW_LOOK))
    assert keys(found)[0] == "tofu-raw"
    assert len(found.candidates) == MOST_CANDIDATES
    assert sum(one.probability for one in found.candidates) + found.none_probability < 1.0


# ---- context


def probabilities(identifier, look, circumstances):
    return {one.food_key: one for one in identifier.identify(asked(look), circumstances).candidates}


def test_candidate_s_reasons_are_what_counts_beside_its_looks():
    identifier = identifier_of(small_index(volumes_ml={"egg": (50.0, 60.0)}), learned("bun", 30, eater="you"))
    own = [Eaten("plum-raw", 720, frozenset({"egg-raw"}))]
    circumstances = Circumstances(55.0, day_minute=720, own=own, eater="me", beside=frozenset({"egg-raw"}))
    found = probabilities(identifier, "yam", circumstances)
    assert {key: one.reasons for key, one in found.items()} == {
        "apple-raw": (),
        "bun-raw": ("usual_in_study",),
        "egg-raw": ("size_fits",),
        "plum-raw": ("eaten_before", "eaten_with"),
    }
    found = probabilities(identifier, "yam", replace(circumstances, volume_ml=900.0, beside=frozenset()))
    assert (found["egg-raw"].reasons, found["plum-raw"].reasons) == (("size_unusual",), ("eaten_before",))


def test_what_was_eaten_with_a_food_beside_counts_three_times():
    identifier = identifier_of(small_index())
    own = [Eaten("plum-raw", 720, frozenset({"egg-raw"}))] * 4

    def odds(beside):
        circumstances = Circumstances(day_minute=720, own=own, beside=beside)
        found = probabilities(identifier, "yam", circumstances)
        return found["plum-raw"].probability / found["bun-raw"].probability

    equal = STUDY_WEIGHT / 4
    assert odds(frozenset({"egg-raw"})) / odds(frozenset()) == pytest.approx((12 + equal) / (4 + equal))


def test_by_looks_alone_neither_size_nor_habit_counts():
    identifier = identifier_of(small_index(volumes_ml={"egg": (50.0, 60.0)}), learned("bun", 30, eater="you"))
    own = [Eaten("plum-raw", 720)] * 9
    alone = Circumstances(55.0, day_minute=720, own=own, looks_alone=True)
    found = identifier.identify(asked("yam"), alone)
    scores = {one.food_key: one.probability for one in found.candidates}
    assert all(one.reasons == () for one in found.candidates)
    plain = identifier_of(small_index(), learned("bun", 30, eater="you"))
    without = {one.food_key: one.probability for one in plain.identify(asked("yam"), replace(alone, own=())).candidates}
    assert scores == pytest.approx(without)

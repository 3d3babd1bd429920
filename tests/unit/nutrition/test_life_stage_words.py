"""What a life stage is called where people read it."""

from app.nutrition.intakes.life_stage import LifeStage


def test_every_stage_is_named_as_a_person_says_it():
    told = [stage.in_words for stage in LifeStage]
    assert told[:4] == ["infant, 0 to 6 months", "infant, 7 to 12 months", "child, 1 to 3", "child, 4 to 8"]
    assert LifeStage.MALE_19_30.in_words == "male, 19 to 30"
    assert LifeStage.FEMALE_OVER_70.in_words == "female, over 70"
    assert LifeStage.PREGNANT_14_18.in_words == "pregnant, 14 to 18"
    assert len(set(told)) == len(LifeStage)
    assert not any("_" in words for words in told)

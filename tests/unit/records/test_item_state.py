"""The fold of a meal's history: what it says of made-up histories, and that a slow one of other build says the same."""

import uuid
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.meals.stored.event_models import MealEvent
from app.meals.stored.item_state import fold_meal
from app.meals.stored.meal_parts import MealParts
from app.meals.stored.models import Meal
from app.meals.stored.record_models import Item, ItemCandidate, ItemFood, ItemMeasure, Leftover

NOW = datetime(2026, 11, 21, tzinfo=UTC)
LAYERS = ("automatic", "participant", "reviewer")
RING = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]]


class History:
    """A meal's parts, word by word."""

    def __init__(self, *volumes_ml):
        self.parts = MealParts(Meal(id=uuid.uuid4()))
        for volume_ml in volumes_ml:
            self.item(volume_ml)

    def item(self, volume_ml=None, event_id=None, **changes):
        known = volume_ml is not None
        item = Item(
            id=uuid.uuid4(),
            event_id=event_id,
            position=len(self.parts.items),
            rings=[RING],
            volume_ml=volume_ml,
            volume_low_ml=0.9 * volume_ml if known else None,
            volume_high_ml=1.1 * volume_ml if known else None,
            relative_sd={"pair": 0.02, "item": 0.05} if known else {},
            flags=[],
            **{"origin": "pipeline"} | changes,
        )
        self.parts.items.append(item)
        return item

    def say(self, kind, item=None, layer="participant", **new):
        event = MealEvent(
            id=uuid.uuid4(),
            sequence=1 + len(self.parts.events),
            item_id=item.id if item is not None else None,
            kind=kind,
            layer=layer,
            old={},
            new=new,
            created_at=NOW,
        )
        self.parts.events.append(event)
        return event

    def set_food(self, item, food_id, layer="participant"):
        event = self.say("set_food", item, layer)
        self.food(item, food_id, layer, event.id)
        return event

    def food(self, item, food_id, layer="automatic", event_id=None):
        self.parts.food_keys[food_id] = f"food-{food_id}"
        rows = self.parts.foods.setdefault(item.id, [])
        rows.append(ItemFood(item_id=item.id, version=1 + len(rows), food_id=food_id, layer=layer, event_id=event_id))

    def split(self, item, layer="participant", polygons=(None, None)):
        event = self.say("split", item, layer, share=1.0)
        made = [self.item(40.0, event.id, origin="split", parent_id=item.id) for _ in polygons]
        event.new = {
            "share": 1.0,
            "parts": [{"item": str(part.id), "polygon": ring} for part, ring in zip(made, polygons, strict=True)],
        }
        return event, made

    def merge(self, items, layer="participant"):
        event = self.say("merge", None, layer, items=[str(item.id) for item in items], share=1.0)
        return event, self.item(80.0, event.id, origin="merged")

    def undo(self, event, layer="participant"):
        return self.say("undo", None, layer, event=str(event.id))

    def candidate(self, item, source):
        rows = self.parts.candidates.setdefault(item.id, [])
        rows.append(ItemCandidate(item_id=item.id, position=len(rows), food_id=1, probability=0.9, source=source))

    def measure(self, item, event, volume_ml, flags=(), run_id=None):
        row = ItemMeasure(
            item_id=item.id,
            event_id=event.id,
            run_id=run_id,
            rings=[RING],
            volume_ml=volume_ml,
            volume_low_ml=volume_ml and 0.8 * volume_ml,
            volume_high_ml=volume_ml and 1.2 * volume_ml,
            relative_sd={},
            flags=list(flags),
        )
        self.parts.measures.setdefault(item.id, []).append(row)

    def states(self):
        return {state.item.id: state for state in fold_meal(self.parts).items}

    def state(self, item):
        return self.states()[item.id]


@pytest.fixture
def one():
    """A history of one item of 100 ml, and the item."""
    history = History(100.0)
    return history, history.parts.items[0]


def test_item_of_which_nobody_spoke_is_as_the_pipeline_found_it_until_its_meal_is_confirmed(one):
    history, item = one
    state = history.state(item)
    assert (state.decision, state.share, state.amount.volume_ml, state.flags) == (None, 1.0, 100.0, ())
    assert state.is_live
    assert not state.reviewed
    history, item = one
    history.say("confirm_meal", items=[str(item.id)])
    later = history.item(20.0)
    assert (history.state(item).decision, history.state(later).decision) == ("confirmed", None)


@pytest.mark.parametrize(("low", "high", "is_told"), [(34.0, 299.0, True), (33.0, 299.0, False), (34.0, 301.0, False)])
def test_volume_of_an_earlier_run_whose_interval_says_nothing_counts_only_once_it_is_confirmed(one, low, high, is_told):
    history, item = one
    item.volume_low_ml, item.volume_high_ml = low, high
    state = history.state(item)
    assert (state.amount.volume_ml, state.flags) == ((100.0, ()) if is_told else (None, ("not_measurable",)))
    history.say("confirm", item)
    state = history.state(item)
    assert (state.amount.volume_ml, state.flags) == (100.0, ())


def test_drawn_region_keeps_the_amount_until_it_is_measured_and_an_older_one_does_not_count_again(one):
    history, item = one
    older = history.say("redraw", item, polygon=RING)
    event = history.say("redraw", item, polygon=RING[::-1])
    waiting = history.state(item)
    assert (waiting.amount.volume_ml, waiting.flags, waiting.rings) == (100.0, ("remeasuring",), [RING[::-1]])
    history.measure(item, event, 140.0)
    history.measure(item, older, 120.0)
    assert (history.state(item).amount.volume_ml, history.state(item).flags) == (140.0, ())


@pytest.mark.parametrize("outcome", ["not_measurable", "remeasure_failed"])
def test_region_that_is_not_measured_leaves_only_what_was_told(one, outcome):
    history, item = one
    event = history.say("redraw", item, polygon=RING)
    if outcome == "remeasure_failed":
        history.parts.failed_remeasures.add(event.id)
    else:
        history.measure(item, event, None, [outcome])
    assert (history.state(item).amount.volume_ml, history.state(item).flags) == (None, (outcome,))
    history.say("set_volume", item, volume_ml=70.0, relative_sd=0.1)
    assert (history.state(item).amount.volume_ml, history.state(item).flags) == (70.0, ())


def test_region_was_seen_by_the_run_whose_measurement_holds(one):
    history, item = one
    item.run_id, first, second = uuid.uuid4(), uuid.uuid4(), uuid.uuid4()
    assert history.state(item).run_id == item.run_id
    older = history.say("redraw", item, polygon=RING)
    assert history.state(item).run_id == item.run_id  # not measured yet
    history.measure(item, older, 50.0, run_id=first)
    assert history.state(item).run_id == first
    newer = history.say("redraw", item, polygon=RING)
    history.parts.failed_remeasures.add(newer.id)
    assert history.state(item).run_id is None
    history.parts.failed_remeasures.clear()
    history.measure(item, newer, 60.0, run_id=second)
    assert history.state(item).run_id == second
    history.undo(newer)
    assert history.state(item).run_id == first


@pytest.mark.parametrize(
    ("sources", "word", "is_guessed"),
    [
        (["index"], None, True),
        (["hint", "index"], None, False),
        ([], None, False),  # taken for it before there was an index
        (["index"], "confirm", False),
        (["index"], "set_volume", True),
    ],
)
def test_food_is_guessed_where_only_the_index_says_so(one, sources, word, is_guessed):
    history, item = one
    history.food(item, 1)
    for source in sources:
        history.candidate(item, source)
    if word is not None:
        history.say(word, item, volume_ml=50.0, relative_sd=0.1)
    assert history.state(item).is_food_guessed is is_guessed


def test_food_is_a_guess_again_once_the_word_is_undone_and_so_is_that_of_a_part(one):
    history, item = one
    history.food(item, 1)
    history.candidate(item, "index")
    said = history.set_food(item, 2)
    assert not history.state(item).is_food_guessed
    history.undo(said)
    assert history.state(item).is_food_guessed
    event, (first, second) = history.split(item)
    history.food(first, 1, "automatic", event.id)
    history.food(second, 1, "participant", event.id)
    assert [history.state(part).is_food_guessed for part in (first, second)] == [True, False]


def test_portion_counts_as_long_as_the_food_that_it_is_of(one):
    history, item = one
    history.set_food(item, 1)
    history.say("set_volume", item, volume_ml=70.0, relative_sd=0.1)
    history.say("set_mass", item, "reviewer", mass_g=182.0, of="edible", relative_sd=0.2, portion_of="food-1")
    assert history.state(item).amount.mass.mass_g == 182.0
    other = history.set_food(item, 2)
    state = history.state(item)
    assert (state.amount.mass, state.amount.volume_ml, state.decision) == (None, 70.0, "corrected")
    history.undo(other)
    assert history.state(item).amount.mass.mass_g == 182.0
    history.food(item, 7, "participant")
    history.parts.food_keys[7] = "food-1"  # a newer version of the food
    assert history.state(item).amount.mass.mass_g == 182.0


def test_declared_food_goes_with_the_item_that_it_came_with(one):
    history, item = one
    event = history.say("declare", item, probe="fat_added", answer="yes", mass_g=5.0, of="edible", relative_sd=0.2)
    butter = history.item(None, event.id, origin="declared", parent_id=item.id)
    assert history.state(butter).decision == "confirmed"
    rejected = history.say("reject", item)
    assert (history.state(butter).decision, history.state(butter).flags) == ("rejected", ("of_rejected",))
    history.undo(rejected)
    history.split(item)
    assert history.state(butter).is_live
    assert fold_meal(history.parts).answers[history.parts.items[-1].id] == {"fat_added"}


def test_leftover_of_merged_items_is_of_the_merged_one_and_of_a_split_one_nobodys():
    history = History(100.0, 50.0)
    first, second = history.parts.items
    piece = history.item(10.0, origin="after")
    row = Leftover(after_item_id=piece.id, version=1, item_id=first.id, leftover_class="food_left", layer="automatic")
    history.parts.leftovers[piece.id] = [row]
    row.flags = []
    _, merged = history.merge([first, second])
    assert fold_meal(history.parts).leftovers[0].of_item_id == merged.id
    history.split(merged)
    left = fold_meal(history.parts).leftovers[0]
    assert (left.of_item_id, left.leftover_class) == (None, "unmatched")


# Random histories, also such as the rules of events would refuse, against a slow fold of another build.

KINDS = (
    "confirm", "reject", "set_food", "set_volume", "set_mass", "portion", "set_share", "split", "merge", "undo",
    "redraw", "reshape",
)  # fmt: skip
STEPS = st.lists(
    st.tuples(
        st.sampled_from(KINDS), st.sampled_from(("participant", "reviewer")), st.integers(0, 99), st.integers(0, 99)
    ),
    max_size=25,
)


def told(steps):
    """A history of these steps; numbers choose items and events among those that there are."""
    history = History(100.0, 60.0, 30.0)
    for item in list(history.parts.items):
        history.food(item, 1)
    for kind, layer, one, other in steps:
        items, events = history.parts.items, history.parts.events
        item = items[one % len(items)]
        if kind == "split":
            history.split(item, layer)
        elif kind == "merge":
            history.merge([item, items[(one + 1 + other % (len(items) - 1)) % len(items)]], layer)
        elif kind == "undo":
            if events:
                history.undo(events[other % len(events)], layer)
        elif kind == "set_food":
            history.set_food(item, 1 + other % 3, layer)
        elif kind == "redraw":
            event = history.say("redraw", item, layer, polygon=RING)
            if other % 3:
                history.measure(item, event, 10.0 + other if other % 2 else None)
        else:
            grams = {"mass_g": 1.0 + other, "of": "edible"}
            values = {
                "set_volume": {"volume_ml": 1.0 + other},
                "reshape": {"volume_ml": 2.0 + other, "form": {}, "run": str(uuid.uuid4())},
                "set_mass": grams,
                "portion": grams | {"portion_of": f"food-{1 + other % 3}"},
            }.get(kind, {})
            said = "set_mass" if kind == "portion" else kind
            history.say(said, item, layer, share=(1 + other) / 100, relative_sd=0.1, **values)
    return history.parts


class SlowFold:
    """Each question answered from the whole history by its definition, with nothing kept."""

    def __init__(self, parts):
        self.parts = parts
        self.items = {item.id: item for item in parts.items}
        self.events = {event.id: event for event in parts.events}

    def is_undone(self, event):
        return any(
            other.kind == "undo" and other.new["event"] == str(event.id) and not self.is_undone(other)
            for other in self.parts.events
            if other.sequence > event.sequence
        )

    def of_event(self, event):
        return [event.item_id] if event.item_id else [uuid.UUID(item) for item in event.new.get("items", ())]

    def counts(self, event):
        if event.kind == "undo" or self.is_undone(event):
            return False
        return all(self.stands(item_id, event.sequence) for item_id in self.of_event(event))

    def stands(self, item_id, before):
        made_by = self.items[item_id].event_id
        if made_by is not None and (self.events[made_by].sequence >= before or not self.counts(self.events[made_by])):
            return False
        return not any(
            item_id in self.of_event(event) and self.counts(event)
            for event in self.parts.events
            if event.kind in ("split", "merge") and event.sequence < before
        )

    def words(self, item, *kinds):
        """Counting events of these kinds about the item, the one that counts most at the head."""
        found = [
            event
            for event in self.parts.events
            if event.kind in kinds and (event.item_id == item.id or event.id == item.event_id) and self.counts(event)
        ]
        found = [event for event in found if event.kind not in ("split", "merge") or event.id == item.event_id]
        return sorted(found, key=lambda event: (LAYERS.index(event.layer), event.sequence), reverse=True)

    def summary(self, item):
        amounts = ("set_volume", "set_mass", "reshape", "redraw")
        spoken = self.words(item, "confirm", "reject", "set_food", *amounts, "split", "merge")
        word = None
        if spoken:
            corrects = any(event.kind not in ("confirm", "reject") for event in spoken)
            word = "rejected" if spoken[0].kind == "reject" else "corrected" if corrects else "confirmed"
        stands = self.stands(item.id, before=1 + len(self.parts.events))
        shares = self.words(item, "set_share")
        return {
            "word": word if stands else "rejected",
            "stands": stands,
            "share": shares[0].new["share"] if shares else 1.0,
            "reviewed": any(event.layer == "reviewer" for event in spoken),
            "food": self.food(item),
            "amount": self.amount(item),
        }

    def food(self, item):
        rows = [
            row
            for row in self.parts.foods.get(item.id, ())
            if row.event_id is None or self.counts(self.events[row.event_id])
        ]
        best = [row for layer in LAYERS[::-1] for row in rows[::-1] if row.layer == layer]
        return best[0].food_id if best else None

    def amount(self, item):
        """("ml" or "g", number) by walking down from the word that counts most; None: not known."""
        measures = {row.event_id: row.volume_ml for row in self.parts.measures.get(item.id, ())}
        is_lost = False
        for event in self.words(item, "set_volume", "set_mass", "reshape", "redraw"):
            if event.kind in ("set_volume", "reshape"):
                return ("ml", event.new["volume_ml"])
            if event.kind == "set_mass" and event.new.get("portion_of") in (None, f"food-{self.food(item)}"):
                return ("g", event.new["mass_g"])
            if event.id in measures and not is_lost:
                if measures[event.id] is not None:
                    return ("ml", measures[event.id])
                is_lost = True
        return None if is_lost or item.volume_ml is None else ("ml", item.volume_ml)


@given(STEPS)
def test_fold_says_what_a_slow_fold_by_definition_says(steps):
    parts = told(steps)
    slow = SlowFold(parts)
    for state in fold_meal(parts).items:
        amount = state.amount
        known = ("g", amount.mass.mass_g) if amount.mass else ("ml", amount.volume_ml) if amount.volume_ml else None
        assert slow.summary(state.item) == {
            "word": state.decision,
            "stands": state.stands,
            "share": state.share,
            "reviewed": state.reviewed,
            "food": state.food_assignment.food_id if state.food_assignment else None,
            "amount": known,
        }

"""The review queue's logic (static/review_queue.js) by itself: no decision is lost, none goes with a wrong version."""

import pytest

from tests.e2e.static_modules import module_page

HARNESS = """
const { ReviewQueue, newId } = await import("/review_queue.js");
const { fewerCorners } = await import("/review_draw.js");
const { typedNumber } = await import("/review_editors.js");
const sent = [], told = [];
const queue = new ReviewQueue({
  send: (entry, word) => new Promise((resolve, reject) => sent.push({ of: entry.id, word, resolve, reject })),
  returned: (entry, decision, problem) => told.push(`returned ${entry.id} ${problem.code}`),
  undone: (entry, problem) => told.push(`undone ${entry.id} ${problem ? problem.code : "well"}`),
  retryMs: [1, 1],
});
const items = (...pairs) => pairs.map(([id, meal, version]) => ({ id, meal, version }));
// A round begins once the work of the one before has set its own, shorter timers: a slow machine changes no order.
const settle = async () => {
  for (let round = 0; round < 5; round += 1) await new Promise((resolve) => setTimeout(resolve, 4));
};
const lines = () => sent.map((one) => `${one.of} ${one.word.kind} v${one.word.version}`);
const conflict = { status: 412, code: "precondition_failed", message: "", retryable: false };
const lost = { status: 0, code: "no_answer", message: "", retryable: true };
"""


@pytest.fixture(scope="module")
def run(chromium):
    """What a script returns that has the harness before it."""
    with module_page(chromium) as page:
        yield lambda script: page.evaluate(f"async () => {{ {HARNESS} {script} }}")


def test_words_of_one_meal_go_in_turn_each_with_the_version_of_the_answer_before(run):
    done = run("""
      queue.add(items(["a", "M", 4], ["b", "M", 4], ["c", "N", 9]));
      queue.decide("a", { kind: "confirm" });
      queue.decide("b", { kind: "confirm" });
      queue.decide("c", { kind: "reject" });
      await settle();
      const first = lines();
      sent[0].resolve({ version: 5 });
      await settle();
      sent[1].resolve({ version: 10 }); sent[2].resolve({ version: 6 });
      await settle();
      return { first, all: lines(), decided: queue.count("decided"), pending: queue.pending, current: queue.currentId };
    """)
    assert done["first"] == ["a confirm v4", "c reject v9"]
    assert done["all"] == ["a confirm v4", "c reject v9", "b confirm v5"]
    assert (done["decided"], done["pending"], done["current"]) == (3, 0, None)


def test_refused_decision_comes_back_behind_the_item_that_is_shown_and_its_neighbours_go_with_what_they_saw(run):
    done = run("""
      queue.add(items(["a", "M", 4], ["b", "M", 4], ["c", "N", 9], ["d", "O", 1]));
      queue.decide("a", { kind: "confirm" });
      queue.decide("b", { kind: "confirm" });
      await settle(); sent[0].reject(conflict); await settle();
      const after = lines();
      sent[1].reject(conflict); await settle();
      const order = [queue.currentId, ...queue.upcoming(9)];
      await queue.read("a", async () => 7);
      queue.decide("c", { kind: "confirm" });
      const next = queue.currentId;
      queue.decide("a", { kind: "confirm" }); await settle();
      return { after, order, next, told, again: lines().at(-1), undoable: queue.canUndo() };
    """)
    assert done["after"] == ["a confirm v4", "b confirm v4"]  # b was not seen as it is by now: it is refused as well
    assert done["order"] in (["c", "b", "a", "d"], ["c", "a", "b", "d"])
    assert sorted(done["told"]) == ["returned a precondition_failed", "returned b precondition_failed"]
    assert done["next"] in ("a", "b")
    assert done["again"] == "a confirm v7"
    assert done["undoable"]


def test_word_without_an_answer_is_said_again_as_the_same_word_and_comes_back_in_the_end(run):
    done = run("""
      queue.add(items(["a", "M", 4], ["b", "N", 1]));
      queue.decide("a", { kind: "confirm" });
      for (let i = 0; i < 3; i += 1) { await settle(); sent[i].reject(lost); }
      await settle();
      const ids = new Set(sent.map((one) => one.word.id));
      const upcoming = queue.upcoming(9);
      queue.step(1);
      queue.decide("a", { kind: "confirm" }); await settle(); sent[3].reject(lost); await settle();
      sent[4].resolve({ version: 5 }); await settle();
      const same = sent[3].word.id === sent[4].word.id;
      return { ids: ids.size, upcoming, told, state: queue.entry("a").state, same };
    """)
    assert (done["ids"], done["upcoming"], done["told"]) == (1, ["a"], ["returned a no_answer"])
    assert (done["state"], done["same"]) == ("decided", True)


def test_undo_waits_for_the_decision_and_of_one_that_was_never_written_nothing_is_taken_back(run):
    done = run("""
      queue.add(items(["a", "M", 4], ["b", "N", 1]));
      queue.decide("a", { kind: "set_food", food: "pear" });
      queue.decide("b", { kind: "confirm" });
      queue.undo();
      const shown = queue.currentId;
      queue.undo(); await settle();
      const before = lines();
      sent[0].reject(conflict); sent[1].resolve({ version: 2 }); await settle();
      const undo = sent.find((one) => one.word.kind === "undo");
      undo.resolve({ version: 3 }); await settle();
      return { shown, before, all: lines(), told, version: queue.entry("b").version, none: queue.undo(),
               of: undo.word.event === sent[1].word.id, waiting: queue.count("waiting") };
    """)
    assert done["shown"] == "b"
    assert done["before"] == ["a set_food v4", "b confirm v1"]
    assert done["all"] == ["a set_food v4", "b confirm v1", "b undo v2"]
    assert sorted(done["told"]) == ["returned a precondition_failed", "undone b well"]
    assert (done["version"], done["of"], done["none"], done["waiting"]) == (3, True, None, 2)


def test_food_and_amount_are_one_decision_saved_and_undone_together(run):
    done = run("""
      queue.add(items(["a", "M", 4]));
      queue.decide("a", { kind: "set_food", food: "pear" }, { kind: "set_mass", mass_g: 80 });
      await settle(); sent[0].resolve({ version: 5 }); await settle(); sent[1].resolve({ version: 6 }); await settle();
      queue.undo(); await settle();
      sent[2].resolve({ version: 7 }); await settle(); sent[3].resolve({ version: 8 }); await settle();
      const undone = sent.slice(2).map((one) => sent.findIndex((other) => other.word.id === one.word.event));
      return { all: lines(), undone, told, none: queue.undo() };
    """)
    assert done["all"] == ["a set_food v4", "a set_mass v5", "a undo v6", "a undo v7"]
    assert (done["undone"], done["told"], done["none"]) == ([1, 0], ["undone a well"], None)


def test_items_passed_by_are_shown_at_the_end_those_skipped_are_not_and_none_twice(run):
    done = run("""
      const fresh = queue.add(items(["a", "A", 1], ["b", "B", 1], ["c", "C", 1], ["d", "D", 1]));
      const again = queue.add(items(["a", "A", 1], ["e", "E", 1]));
      queue.step(1);
      queue.skip("b");
      queue.decide("c", { kind: "confirm" });
      queue.drop("d");
      queue.decide("e", { kind: "confirm" });
      const last = queue.currentId;
      queue.decide("a", { kind: "confirm" });
      const [end, skipped, back] = [queue.currentId, queue.count("skipped"), queue.step(-1)];
      return { fresh, again, last, end, skipped, back, at: queue.currentId };
    """)
    assert (done["fresh"], done["again"]) == (["a", "b", "c", "d"], ["e"])
    assert (done["last"], done["end"], done["skipped"]) == ("a", None, 1)
    assert (done["back"], done["at"]) == (True, "e")


def test_numbers_are_read_as_people_type_them_and_ids_are_such_as_the_api_takes(run):
    typed = ["120", "120,5", " 1 200.25 ", "0", "-3", "1e3", "", "abc", "20001", "5.", "1,500", "0,125"]
    done = run(f"return {{ read: {typed!r}.map(typedNumber), ids: [newId(), newId()] }};")
    assert done["read"] == [120, 120.5, 1200.25, None, None, None, None, None, None, 5, None, 0.125]
    assert done["ids"][0] != done["ids"][1]
    assert all(one[14] == "4" and len(one) == 36 for one in done["ids"])


def test_fewer_corners_keep_those_that_bend(run):
    square = [[x, 0] for x in range(10)] + [[10, y] for y in range(10)]
    square += [[x, 10] for x in range(10, 0, -1)] + [[0, y] for y in range(10, 0, -1)]
    assert run(f"return fewerCorners({square!r}, 4);") == [[0, 0], [10, 0], [10, 10], [0, 10]]

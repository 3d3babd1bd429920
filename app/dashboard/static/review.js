// The review queue's page: the reviewer's actions on the shown card, by keys (review_keys.js) and buttons. The cards are
// in review_cards.js, the logic in review_queue.js, requests in review_wire.js.

import { Cards } from "./review_cards.js";
import { drawOutline } from "./review_draw.js";
import { editors } from "./review_editors.js";
import { followKeys } from "./review_keys.js";
import { Notices } from "./review_notices.js";
import { ReviewQueue } from "./review_queue.js";
import { sendWord } from "./review_wire.js";

const root = document.querySelector("[data-review]");
if (root) start();

function start() {
  const find = (selector) => root.querySelector(selector);
  const status = find("[data-status]");
  const notices = new Notices(find("[data-notices]"), root.dataset.signIn);
  const say = (text) => (status.textContent = text);
  const edit = editors(root, { foods: root.dataset.foods, say });
  let drawing = null;
  let held = null; // of the shown item: the food without the amount, or the amount without the food

  const work = { leave: leaveCard, isDrawing: () => drawing !== null, moveTo: edit.moveTo };
  const cards = new Cards(root, { notices, say, work });
  const queue = new ReviewQueue({
    send: (entry, word) => sendWord(cards.of(entry.id), word),
    changed: () => cards.update(),
    returned: (entry, decision, problem) => cards.bringBack(entry, problem, decision.words.map(told).join(", ")),
    undone: (entry, problem) => {
      if (problem) cards.bringBack(entry, problem, "undo");
      else say(`Undone: ${cards.of(entry.id).dataset.title} waits again.`);
    },
  });

  function told(word) {
    const value = word.food ?? (word.mass_g && `${word.mass_g} g`) ?? (word.volume_ml && `${word.volume_ml} ml`);
    return value ? `${word.kind.replace("_", " ")} ${value}` : word.kind.replace("_", " ");
  }

  // ---- decisions

  // Food and amount are one decision: of an item that lacks one, the other is held until both are there.
  function decide(word, done) {
    const card = cards.shown;
    const words = held ? [held, word] : [word];
    const isCorrection = ["set_food", "set_mass", "set_volume"].includes(word.kind);
    const hasFood = card.dataset.food !== "" || words.some((one) => one.kind === "set_food");
    if (isCorrection && !(hasFood && hasAmount(card, ...words))) {
      held = word;
      say(`${done} ${hasFood ? "How much is it?" : "What is it?"} It is saved with both.`);
      edit.open(hasFood ? "mass" : "food", card, taken);
      return;
    }
    held = null;
    card.dataset.stale = "yes"; // it is read again when it is shown again
    card.dataset.decided = "yes"; // until a newly read card replaces it
    queue.decide(cards.shownId, ...(isCorrection ? words : [word]));
    const next = cards.shown;
    say(`${done}${next ? ` Next: ${next.dataset.title}` : ""}`);
  }

  function hasAmount(card, ...words) {
    const isSet = words.some((word) => ["set_mass", "set_volume"].includes(word.kind));
    return isSet || card.dataset.mass !== "" || card.dataset.volume !== "";
  }

  function chooseFood(key, name) {
    const card = cards.shown;
    cards.choose(choices().find((one) => one.value === key) ?? null); // the card stays for its amount, if that is unknown
    card.dataset.named = name;
    const isAsShown = !card.dataset.decided; // otherwise the food might have changed meanwhile
    if (isAsShown && key === card.dataset.food && hasAmount(card)) decide({ kind: "confirm" }, `Confirmed: ${name}.`);
    else decide({ kind: "set_food", food: key }, `It is ${name}.`);
  }

  const choices = () => [...cards.shown.querySelectorAll(".choice")];
  const takeChoice = (button) => chooseFood(button.value, button.dataset.name);

  function confirm() {
    const card = cards.shown;
    const { food, named, title, unmarked } = card.dataset;
    const marked = card.querySelector(".choice.marked");
    if (held?.kind === "set_food") edit.open("mass", card, taken);
    else if (marked) takeChoice(marked);
    else if (unmarked && !named) say(`${unmarked}: ${hasLetters() ? "choose by number, or search (/)." : "choose by arrow keys, or search."}`);
    else if (food) chooseFood(food, named ?? title);
    else {
      say("What is it? Search for the food.");
      edit.open("food", card, taken);
    }
  }

  const hasLetters = () => !root.classList.contains("no-letters");

  // direction: 1, the next candidate; -1, the one before.
  function markCandidate(direction) {
    const all = choices();
    if (!all.length) return;
    const here = all.findIndex((one) => one.classList.contains("marked"));
    const next = here === -1 ? all.at(direction > 0 ? 0 : -1) : all[(here + direction + all.length) % all.length];
    cards.choose(next);
    say(`${next.dataset.name}: Enter takes it.`);
  }

  // The value of an editor.
  function taken(kind, value) {
    if (kind === "food") chooseFood(value.key, value.name);
    else if (kind === "mass") decide({ kind: "set_mass", ...value }, `Mass set: ${value.mass_g} g.`);
    else if (kind === "volume") decide({ kind: "set_volume", ...value }, `Volume set: ${value.volume_ml} ml.`);
    else if (kind === "comment") remark(value.text);
  }

  async function remark(text) {
    const card = cards.shown;
    const id = cards.shownId;
    edit.close();
    cards.focus();
    card.dataset.stale = "yes";
    try {
      await queue.remark(id, { kind: "comment", text });
      say(`Comment saved: ${card.dataset.title}.`);
    } catch (problem) {
      notices.add(`Not saved: the comment on ${card.dataset.title} (${card.dataset.who}): “${text}”`, problem);
      await cards.readAnew(queue.entry(id));
    }
  }

  // ---- drawing

  function startDrawing() {
    const card = cards.shown;
    const svg = card.querySelector(".review-crop svg");
    if (!svg) {
      say("There is no photograph to draw on.");
      return;
    }
    edit.open("draw", card, taken);
    const image = svg.querySelector("image");
    drawing = drawOutline(svg, {
      ring: JSON.parse(card.querySelector("[data-corners]").textContent),
      near: svg.dataset.view.split(" ").map(Number),
      size: [Number(image.getAttribute("width")), Number(image.getAttribute("height"))],
      say,
      done(corners) {
        drawing = null;
        edit.close();
        if (corners === null) {
          card.focus({ preventScroll: true });
          say("The outline stays as it was.");
        } else {
          decide({ kind: "redraw", polygon: JSON.stringify(corners) }, `Drawn anew: ${card.dataset.title} is being measured.`);
        }
      },
    });
  }

  // Drawing and editors.
  function putDown() {
    drawing?.cancel();
    edit.close();
  }

  function leaveCard() {
    putDown();
    held = null;
  }

  const actions = {
    confirm,
    candidate: () => markCandidate(1),
    candidateBefore: () => markCandidate(-1),
    food: () => edit.open("food", cards.shown, taken),
    mass: () => edit.open("mass", cards.shown, taken),
    volume: () => edit.open("volume", cards.shown, taken),
    comment: () => edit.open("comment", cards.shown, taken),
    draw: startDrawing,
    reject: () => decide({ kind: "reject" }, `Rejected: ${cards.shown.dataset.title}.`),
    skip() {
      const { title } = cards.shown.dataset;
      queue.skip(cards.shownId);
      say(`Skipped: ${title}.${cards.shown ? ` Next: ${cards.shown.dataset.title}` : ""}`);
    },
    undo() {
      if (held) {
        held = null;
        say("Taken back: nothing of it was saved.");
        return;
      }
      const entry = queue.undo();
      say(entry ? `Undoing: ${cards.of(entry.id).dataset.title} …` : "There is nothing to undo.");
    },
    open: () => location.assign(cards.shown.dataset.page),
    previous: () => queue.step(-1) || say("This is the first item."),
    next: () => queue.step(1) || say("There is no next item here yet."),
    help: () => find("[data-help]").showModal(),
  };

  function act(action) {
    if (!cards.can(action)) return;
    drawing?.cancel();
    actions[action]();
  }

  root.addEventListener("click", (event) => {
    const button = event.target.closest("[data-do]");
    if (button) act(button.dataset.do);
    const tool = event.target.closest("[data-draw]");
    if (tool) drawing?.[tool.dataset.draw]();
  });

  root.addEventListener("submit", (event) => {
    if (!event.target.matches("[data-choices]")) return;
    event.preventDefault();
    if (event.submitter) takeChoice(event.submitter);
  });

  followKeys(root, {
    cards,
    act,
    choose: takeChoice,
    leave() {
      putDown();
      cards.focus();
    },
  });

  addEventListener("beforeunload", (event) => {
    if (queue.pending) event.preventDefault(); // the browser asks whether to leave
  });

  root.classList.add("is-worked");
  cards.begin(queue);
}

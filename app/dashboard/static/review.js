// The review queue's page: shows one card at a time, takes keys and buttons, tells what was done. The logic is in
// review_queue.js, what goes over the wire in review_wire.js.

import { drawOutline } from "./review_draw.js";
import { editors } from "./review_editors.js";
import { ReviewQueue } from "./review_queue.js";
import { Notices } from "./review_notices.js";
import { fetchPart, sendWord } from "./review_wire.js";

const root = document.querySelector("[data-review]");
if (root) start();

function start() {
  const find = (selector) => root.querySelector(selector);
  const place = find("[data-place]");
  const status = find("[data-status]");
  const help = find("[data-help]");
  const isOn = find("[data-shortcuts-on]");
  const position = document.querySelector("[data-position]");
  const notices = new Notices(find("[data-notices]"), root.dataset.signIn);
  const SETTLE_MS = 150; // a key that comes sooner after a card was shown was meant for the one before
  const AHEAD = 5; // cards that are there before they are needed
  const PICTURES = 2; // of these, those whose pictures are fetched
  let shownId = null;
  let shownAt = 0;
  let number = 0; // of the card since the page was opened
  let more = root.dataset.more ?? null;
  let isFetching = false;
  let left = { count: Number(root.dataset.waiting), isMore: "isMore" in root.dataset, settled: 0 };
  let drawing = null;

  const cardOf = (id) => document.getElementById(`item-${id}`);
  const shown = () => (shownId === null ? null : cardOf(shownId));
  const say = (text) => (status.textContent = text);

  const queue = new ReviewQueue({
    send: (entry, word) => sendWord(cardOf(entry.id), word),
    changed: update,
    returned: (entry, decision, problem) => bringBack(entry, problem, told(decision.word)),
    undone: (entry, problem) => {
      if (problem) bringBack(entry, problem, "undo");
      else say(`Undone: ${cardOf(entry.id).dataset.title} waits again.`);
    },
  });
  const edit = editors(root, { foods: root.dataset.foods, say });

  function told(word) {
    const value = word.food ?? (word.mass_g && `${word.mass_g} g`) ?? (word.volume_ml && `${word.volume_ml} ml`);
    return value ? `${word.kind.replace("_", " ")} ${value}` : word.kind.replace("_", " ");
  }

  // ---- what is shown

  function enter(cards) {
    const items = cards.map((card) => {
      card.hidden = true;
      for (const one of card.querySelectorAll("noscript")) one.remove();
      return { id: card.dataset.item, meal: card.dataset.meal, version: Number(card.dataset.version) };
    });
    const fresh = new Set(queue.add(items));
    for (const card of cards) if (!fresh.has(card.dataset.item) && cardOf(card.dataset.item) !== card) card.remove();
  }

  function update() {
    if (queue.currentId !== shownId) show(queue.currentId);
    const settled = queue.count("sent", "decided", "gone");
    const here = Math.max(0, left.count - (settled - left.settled));
    const skipped = queue.count("skipped");
    const waits = `${left.isMore ? "more than " : "about "}${here} left`;
    position.textContent = queue.current
      ? `Item ${number} of this visit, ${waits}${skipped ? `, ${skipped} skipped` : ""}${queue.pending ? " · saving …" : ""}`
      : `${queue.pending ? "Saving …" : "All that was decided is saved."}`;
    find('[data-do="undo"]').disabled = !queue.canUndo();
    fetchMore();
  }

  function show(id) {
    stopDrawing();
    edit.close();
    const before = shown();
    if (before) before.hidden = true;
    shownId = id;
    const card = shown();
    find("[data-end]").hidden = card !== null || isFetching || more !== null;
    find("[data-keys]").hidden = card === null && !queue.canUndo();
    for (const button of root.querySelectorAll("[data-keys] [data-do]")) {
      button.disabled = card === null && !["undo", "previous", "help"].includes(button.dataset.do);
    }
    if (card === null) {
      showEnd();
      return;
    }
    number += 1;
    card.hidden = false;
    shownAt = performance.now();
    markFirst(card);
    loadPictures(card);
    for (const next of queue.upcoming(PICTURES)) loadPictures(cardOf(next));
    card.focus({ preventScroll: true });
    if (card.getBoundingClientRect().top < 0 || card.getBoundingClientRect().top > innerHeight / 2) card.scrollIntoView();
    if (card.dataset.stale) readAnew(queue.entry(id));
  }

  function showEnd() {
    if (isFetching || more !== null) {
      say("The next items come …");
      return;
    }
    const skipped = queue.count("skipped");
    const end = find("[data-end]");
    find("[data-end-text]").textContent =
      (skipped ? `${skipped} ${skipped === 1 ? "item was" : "items were"} skipped and will come again.` : "No item is left.") +
      " New ones may have come meanwhile.";
    end.hidden = false;
    end.focus();
  }

  function loadPictures(card) {
    for (const image of card.querySelectorAll("image[data-href]:not([href])")) image.setAttribute("href", image.dataset.href);
  }

  function markFirst(card) {
    mark(card, card.querySelector(".choice[data-current]") ?? card.querySelector(".choice"));
  }

  function mark(card, button) {
    for (const one of card.querySelectorAll(".choice")) {
      one.classList.toggle("marked", one === button);
      one.setAttribute("aria-pressed", String(one === button));
    }
  }

  async function fetchMore() {
    if (more === null || isFetching || queue.upcoming(AHEAD).length >= AHEAD) return;
    isFetching = true;
    try {
      const part = await fetchPart(more);
      const batch = part.querySelector("[data-cards]");
      const cards = [...batch.querySelectorAll("[data-item]")].map((card) => document.importNode(card, true));
      more = batch.dataset.more ?? null;
      place.append(...cards.filter((card) => !cardOf(card.dataset.item)));
      enter(cards.filter((card) => place.contains(card)));
      left = {
        count: Number(batch.dataset.waiting),
        isMore: "isMore" in batch.dataset,
        settled: queue.count("decided", "gone"),
      };
      isFetching = false;
      if (shownId === null || queue.currentId === null) {
        shownId = undefined; // whatever there is now is shown: a card, or the end
        update();
      } else {
        update();
      }
    } catch (problem) {
      notices.add("The next items could not be fetched.", problem, () => {
        isFetching = false;
        fetchMore();
      });
    }
  }

  // ---- what was refused

  async function bringBack(entry, problem, what) {
    const { title, who } = cardOf(entry.id).dataset;
    const isNext = queue.currentId !== entry.id;
    notices.add(`Not saved: ${what}, ${title} (${who}).${isNext ? " It comes again next." : ""}`, problem);
    update();
    await readAnew(entry);
  }

  // The card as its item stands, behind all that is being said of its meal.
  async function readAnew(entry) {
    const { again, item, seen, title, who } = cardOf(entry.id).dataset;
    delete cardOf(entry.id).dataset.stale;
    try {
      let card = null;
      await queue.read(entry.id, async () => {
        const part = await fetchPart(`${again}?${new URLSearchParams({ item, seen })}`);
        card = document.importNode(part.querySelector("[data-item]"), true);
        return Number(card.dataset.version);
      });
      if ("settled" in card.dataset) {
        const words = [...card.querySelectorAll("[data-said] li")].map((line) => line.textContent.trim());
        notices.add(`${title} (${who}) was settled by somebody else. ${words.join("; ")}`);
        queue.drop(entry.id);
      } else {
        replace(entry, card);
      }
    } catch (problem) {
      if (problem.status === 404 || problem.status === 410) {
        notices.add(`${title} (${who}) is not there any more.`, problem);
        queue.drop(entry.id);
      } else {
        tellOn(cardOf(entry.id), problem);
      }
    }
  }

  function replace(entry, card) {
    const old = cardOf(entry.id);
    if (entry.id === shownId && drawing) return; // one draws on it: its version is known, that is enough
    card.hidden = old.hidden;
    old.before(card);
    const isTyping = entry.id === shownId && edit.moveTo(card);
    const hadFocus = old.contains(document.activeElement) || document.activeElement === document.body;
    old.remove();
    if (entry.problem) tellOn(card, entry.problem);
    if (entry.id !== shownId) return;
    if (entry.problem) shownAt = performance.now(); // it may look otherwise
    markFirst(card);
    loadPictures(card);
    if (!isTyping && hadFocus) card.focus({ preventScroll: true });
  }

  function tellOn(card, problem) {
    const line = document.createElement("p");
    line.className = "refused";
    line.textContent = problem.message;
    card.querySelector("[data-problem]").replaceChildren(line);
  }

  // ---- what is done

  function decide(word, done) {
    const card = shown();
    const id = shownId;
    const isWhole = { food: word.kind === "set_food" || card.dataset.food !== "", mass: hasAmount(card, word) };
    const stays = ["set_food", "set_mass", "set_volume"].includes(word.kind) && !(isWhole.food && isWhole.mass);
    if (word.kind === "set_food") card.dataset.food = word.food;
    if (word.kind === "set_mass") card.dataset.mass = word.mass_g;
    card.dataset.stale = "yes"; // if it is looked at again, it is read anew
    queue.decide(id, word, { stays });
    if (stays) {
      say(`${done} ${isWhole.food ? "How much is it?" : "What is it?"}`);
      edit.open(isWhole.food ? "mass" : "food", card, taken);
    } else {
      const next = shown();
      say(`${done}${next ? ` Next: ${next.dataset.title}` : ""}`);
    }
  }

  function hasAmount(card, word) {
    return ["set_mass", "set_volume"].includes(word.kind) || card.dataset.mass !== "" || card.dataset.volume !== "";
  }

  function chooseFood(key, name) {
    const card = shown();
    if (key === card.dataset.food && hasAmount(card, {})) decide({ kind: "confirm" }, `Confirmed: ${name}.`);
    else decide({ kind: "set_food", food: key }, `It is ${name}.`);
  }

  // From an editor: what was typed.
  function taken(kind, value) {
    if (kind === "food") chooseFood(value.key, value.name);
    else if (kind === "mass") decide({ kind: "set_mass", ...value }, `Mass set: ${value.mass_g} g.`);
    else if (kind === "volume") decide({ kind: "set_volume", ...value }, `Volume set: ${value.volume_ml} ml.`);
    else if (kind === "comment") remark(value.text);
  }

  async function remark(text) {
    const card = shown();
    const id = shownId;
    edit.close();
    card.focus({ preventScroll: true });
    card.dataset.stale = "yes";
    try {
      await queue.remark(id, { kind: "comment", text });
      say(`Comment saved: ${card.dataset.title}.`);
    } catch (problem) {
      notices.add(`Not saved: the comment on ${card.dataset.title} (${card.dataset.who}): “${text}”`, problem);
      await readAnew(queue.entry(id));
    }
  }

  function startDrawing() {
    const card = shown();
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

  function stopDrawing() {
    drawing?.cancel();
  }

  function leave() {
    const card = shown();
    stopDrawing();
    edit.close();
    card?.focus({ preventScroll: true });
  }

  const actions = {
    confirm() {
      const marked = shown().querySelector(".choice.marked");
      const card = shown();
      if (marked) chooseFood(marked.value, marked.dataset.name);
      else if (card.dataset.food) chooseFood(card.dataset.food, card.dataset.title);
      else {
        say("What is it? Search for the food.");
        edit.open("food", card, taken);
      }
    },
    candidate() {
      const all = [...shown().querySelectorAll(".choice")];
      if (!all.length) return;
      const next = all[(all.findIndex((one) => one.classList.contains("marked")) + 1) % all.length];
      mark(shown(), next);
      say(`${next.dataset.name}: Enter takes it.`);
    },
    food: () => edit.open("food", shown(), taken),
    mass: () => edit.open("mass", shown(), taken),
    volume: () => edit.open("volume", shown(), taken),
    comment: () => edit.open("comment", shown(), taken),
    draw: startDrawing,
    reject: () => decide({ kind: "reject" }, `Rejected: ${shown().dataset.title}.`),
    skip() {
      const { title } = shown().dataset;
      queue.skip(shownId);
      say(`Skipped: ${title}.${shown() ? ` Next: ${shown().dataset.title}` : ""}`);
    },
    undo() {
      const entry = queue.undo();
      say(entry ? `Undoing: ${cardOf(entry.id).dataset.title} …` : "There is nothing to undo.");
    },
    open: () => location.assign(shown().dataset.page),
    previous: () => queue.step(-1) || say("This is the first item."),
    next: () => queue.step(1) || say("There is no next item here yet."),
    help: () => help.showModal(),
  };
  const KEYS = {
    y: "confirm", n: "candidate", f: "food", "/": "food", m: "mass", v: "volume", d: "draw", x: "reject", s: "skip",
    c: "comment", u: "undo", o: "open", k: "previous", j: "next", "?": "help",
  };
  const REPEATED = new Set(["candidate", "previous", "next"]); // a key that is held down may go on with these
  const WITHOUT_CARD = new Set(["undo", "previous", "help"]);

  function act(action) {
    if (shown() === null && !WITHOUT_CARD.has(action)) return;
    stopDrawing();
    actions[action]();
  }

  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const target = event.target;
    if (event.key === "Escape") {
      leave();
      return;
    }
    if (target.closest("input, select, textarea, [contenteditable]")) return;
    const isEnter = event.key === "Enter";
    if (isEnter && target.closest("a, button, summary, [role=option]")) return; // it is pressed, not the card
    if (isEnter && shown() === null && !find("[data-end]").hidden) {
      if (!event.repeat) find("[data-round]").click();
      return;
    }
    if (!isEnter && !isOn.checked) return;
    const choice = /^[1-9]$/.test(event.key) ? shown()?.querySelector(`.choice[data-key="${event.key}"]`) : null;
    const action = isEnter ? "confirm" : KEYS[event.key];
    if (!choice && !action) return;
    event.preventDefault();
    if (event.repeat && !REPEATED.has(action)) return;
    if (performance.now() - shownAt < SETTLE_MS && !REPEATED.has(action)) return;
    if (choice) chooseFood(choice.value, choice.dataset.name);
    else act(action);
  });

  root.addEventListener("click", (event) => {
    const button = event.target.closest("[data-do]");
    if (button) act(button.dataset.do);
    const tool = event.target.closest("[data-draw]");
    if (tool) drawing?.[tool.dataset.draw]();
  });

  root.addEventListener("submit", (event) => {
    if (!event.target.matches("[data-choices]")) return;
    event.preventDefault();
    if (event.submitter) chooseFood(event.submitter.value, event.submitter.dataset.name);
  });

  // single letters can be switched off (WCAG 2.1.4); Enter stays, as on any button
  function applyShortcuts() {
    localStorage.setItem("tada-review-letters", isOn.checked ? "on" : "off");
    for (const button of root.querySelectorAll("[data-shortcuts]")) {
      const keys = isOn.checked ? button.dataset.shortcuts : button.dataset.shortcuts.includes("Enter") ? "Enter" : "";
      if (keys) button.setAttribute("aria-keyshortcuts", keys);
      else button.removeAttribute("aria-keyshortcuts");
    }
    root.classList.toggle("no-letters", !isOn.checked);
  }
  isOn.checked = localStorage.getItem("tada-review-letters") !== "off";
  isOn.addEventListener("change", applyShortcuts);
  applyShortcuts();

  addEventListener("beforeunload", (event) => {
    if (queue.pending) event.preventDefault(); // the browser asks whether to leave
  });

  root.classList.add("is-worked");
  enter([...place.querySelectorAll("[data-item]")]);
  update();
}

// The cards of the review page: which one is shown, its pictures and its marked choice. Later cards are fetched in
// advance, and a card whose meal has changed is read again.

import { fetchPart } from "./review_wire.js";

const AHEAD = 5; // cards that are fetched in advance
const PICTURES = 2; // of these, cards whose pictures are fetched
const WITHOUT_CARD = ["undo", "previous", "help"]; // actions that need no item

// notices: failed actions. say(text): for the live region. work: the reviewer's unfinished work on a card,
// {leave(): gives it up, isDrawing(), moveTo(card): moves the open field to it, true if there is one}.
export class Cards {
  shownId = null;
  shownAt = 0;
  #root;
  #notices;
  #say;
  #work;
  #queue = null;
  #number = 0; // number of the card since the page was opened
  #more;
  #isFetching = false;
  #left;

  constructor(root, { notices, say, work }) {
    this.#root = root;
    this.#notices = notices;
    this.#say = say;
    this.#work = work;
    this.#more = root.dataset.more ?? null;
    this.#left = { count: Number(root.dataset.waiting), isMore: "isMore" in root.dataset, settled: 0 };
  }

  // queue: a ReviewQueue, which may request cards from now on.
  begin(queue) {
    this.#queue = queue;
    this.#enter([...this.#find("[data-place]").querySelectorAll("[data-item]")]);
    this.update();
  }

  of(id) {
    return document.getElementById(`item-${id}`);
  }

  get shown() {
    return this.shownId === null ? null : this.of(this.shownId);
  }

  get isAtEnd() {
    return this.shown === null && !this.#find("[data-end]").hidden;
  }

  can(action) {
    return this.shown !== null || WITHOUT_CARD.includes(action);
  }

  // The queue has moved: show its item and position, and fetch the next cards.
  update() {
    const queue = this.#queue;
    if (queue.currentId !== this.shownId) this.#show(queue.currentId);
    const settled = queue.count("sent", "decided", "gone");
    const here = Math.max(0, this.#left.count - (settled - this.#left.settled));
    const skipped = queue.count("skipped");
    const waits = `${this.#left.isMore ? "more than " : "about "}${here} left`;
    document.querySelector("[data-position]").textContent = queue.current
      ? `Item ${this.#number} of this visit, ${waits}${skipped ? `, ${skipped} skipped` : ""}${queue.pending ? " · saving …" : ""}`
      : `${queue.pending ? "Saving …" : "All that was decided is saved."}`;
    this.#find('[data-do="undo"]').disabled = !queue.canUndo();
    this.#fetchMore();
  }

  // Mark this choice of the shown card for Enter; null: none.
  choose(button) {
    if (button) this.shown.dataset.chosen = button.value;
    this.#mark(this.shown, button);
  }

  focus() {
    this.shown?.focus({ preventScroll: true });
  }

  // A decision was not saved: show it, and the item's current card.
  async bringBack(entry, problem, what) {
    const { title, who } = this.of(entry.id).dataset;
    const isNext = this.#queue.currentId !== entry.id;
    this.#notices.add(`Not saved: ${what}, ${title} (${who}).${isNext ? " It comes again next." : ""}`, problem);
    this.update();
    await this.readAnew(entry);
  }

  // Read the item's current card after all events of its meal were sent.
  async readAnew(entry) {
    const { again, item, seen, title, who } = this.of(entry.id).dataset;
    delete this.of(entry.id).dataset.stale;
    try {
      let card = null;
      await this.#queue.read(entry.id, async () => {
        const part = await fetchPart(`${again}?${new URLSearchParams({ item, seen })}`);
        card = document.importNode(part.querySelector("[data-item]"), true);
        return Number(card.dataset.version);
      });
      if ("settled" in card.dataset) {
        const words = [...card.querySelectorAll("[data-said] li")].map((line) => line.textContent.trim());
        this.#notices.add(`${title} (${who}) was settled by somebody else. ${words.join("; ")}`);
        this.#queue.drop(entry.id);
      } else {
        this.#replace(entry, card);
      }
    } catch (problem) {
      if (problem.status === 404 || problem.status === 410) {
        this.#notices.add(`${title} (${who}) no longer exists.`, problem);
        this.#queue.drop(entry.id);
      } else {
        this.#tellOn(this.of(entry.id), problem);
      }
    }
  }

  #find(selector) {
    return this.#root.querySelector(selector);
  }

  #enter(cards) {
    const items = cards.map((card) => {
      card.hidden = true;
      for (const one of card.querySelectorAll("noscript")) one.remove();
      return { id: card.dataset.item, meal: card.dataset.meal, version: Number(card.dataset.version) };
    });
    const fresh = new Set(this.#queue.add(items));
    for (const card of cards) {
      if (!fresh.has(card.dataset.item) && this.of(card.dataset.item) !== card) card.remove();
    }
  }

  #show(id) {
    this.#work.leave();
    const before = this.shown;
    if (before) before.hidden = true;
    this.shownId = id;
    const card = this.shown;
    this.#find("[data-end]").hidden = card !== null || this.#isFetching || this.#more !== null;
    this.#find("[data-keys]").hidden = card === null && !this.#queue.canUndo();
    for (const button of this.#root.querySelectorAll("[data-keys] [data-do]")) button.disabled = !this.can(button.dataset.do);
    if (card === null) {
      this.#showEnd();
      return;
    }
    this.#number += 1;
    card.hidden = false;
    this.shownAt = performance.now();
    this.#markFirst(card);
    this.#loadPictures(card);
    for (const next of this.#queue.upcoming(PICTURES)) this.#loadPictures(this.of(next));
    this.focus();
    if (card.getBoundingClientRect().top < 0 || card.getBoundingClientRect().top > innerHeight / 2) card.scrollIntoView();
    if (card.dataset.stale) this.readAnew(this.#queue.entry(id));
  }

  #showEnd() {
    if (this.#isFetching || this.#more !== null) {
      this.#say("The next items come …");
      return;
    }
    const skipped = this.#queue.count("skipped");
    const end = this.#find("[data-end]");
    this.#find("[data-end-text]").textContent =
      (skipped ? `${skipped} ${skipped === 1 ? "item was" : "items were"} skipped and will come again.` : "No item is left.") +
      " New ones may have come meanwhile.";
    end.hidden = false;
    end.focus();
  }

  #loadPictures(card) {
    for (const image of card.querySelectorAll("image[data-href]:not([href])")) image.setAttribute("href", image.dataset.href);
  }

  // The choice that the server has marked, if any.
  #markFirst(card) {
    delete card.dataset.chosen;
    delete card.dataset.named;
    this.#mark(card, card.querySelector(".choice[data-marked]"));
  }

  #mark(card, button) {
    for (const one of card.querySelectorAll(".choice")) {
      one.classList.toggle("marked", one === button);
      one.setAttribute("aria-pressed", String(one === button));
    }
  }

  async #fetchMore() {
    if (this.#more === null || this.#isFetching || this.#queue.upcoming(AHEAD).length >= AHEAD) return;
    this.#isFetching = true;
    try {
      const part = await fetchPart(this.#more);
      const batch = part.querySelector("[data-cards]");
      const cards = [...batch.querySelectorAll("[data-item]")].map((card) => document.importNode(card, true));
      this.#more = batch.dataset.more ?? null;
      const place = this.#find("[data-place]");
      place.append(...cards.filter((card) => !this.of(card.dataset.item)));
      this.#enter(cards.filter((card) => place.contains(card)));
      this.#left = {
        count: Number(batch.dataset.waiting),
        isMore: "isMore" in batch.dataset,
        settled: this.#queue.count("decided", "gone"),
      };
      this.#isFetching = false;
      if (this.shownId === null || this.#queue.currentId === null) this.shownId = undefined; // show the first available item
      this.update();
    } catch (problem) {
      this.#notices.add("The next items could not be fetched.", problem, () => {
        this.#isFetching = false;
        this.#fetchMore();
      });
    }
  }

  #replace(entry, card) {
    const old = this.of(entry.id);
    const isShown = entry.id === this.shownId;
    if (isShown && this.#work.isDrawing()) return; // the reviewer is drawing on it: only its version is updated
    card.hidden = old.hidden;
    old.before(card);
    const isTyping = isShown && this.#work.moveTo(card);
    const hadFocus = old.contains(document.activeElement) || document.activeElement === document.body;
    old.remove();
    if (entry.problem) this.#tellOn(card, entry.problem);
    if (!isShown) return;
    this.#markFirst(card);
    const chosen = entry.problem ? undefined : [...card.querySelectorAll(".choice")].find((one) => one.value === old.dataset.chosen);
    if (chosen) this.choose(chosen);
    if (entry.problem) this.shownAt = performance.now(); // it may have changed
    this.#loadPictures(card);
    if (!isTyping && hadFocus) this.focus();
  }

  #tellOn(card, problem) {
    const line = document.createElement("p");
    line.className = "refused";
    line.textContent = problem.message;
    card.querySelector("[data-problem]").replaceChildren(line);
  }
}

// The review queue's logic, without a page: the shown item, decisions, and that no decision is lost.
//
// A decision moves on at once and is sent in the background; events of a meal are sent one after the other, each with the
// meal's version with which its item was shown. A refused decision brings its item back. tests/e2e/test_review_logic.py

export const RETRY_MS = [400, 1500, 4000]; // after no response, or a retryable one

const OPEN = new Set(["waiting"]);

// Makes an id for the API; crypto.randomUUID is missing under plain HTTP.
export function newId() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  bytes[6] = (bytes[6] & 0x0f) | 0x40;
  bytes[8] = (bytes[8] & 0x3f) | 0x80;
  const hex = Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
  return [hex.slice(0, 8), hex.slice(8, 12), hex.slice(12, 16), hex.slice(16, 20), hex.slice(20)].join("-");
}

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

// send(entry, word): sends an event of an item, resolves to {version}, rejects with {status, code, message, retryable}.
// Callbacks: changed(), when the queue has moved; returned(entry, decision, problem), when a decision was not saved;
// undone(entry, problem or null), when a decision was undone or could not be.
export class ReviewQueue {
  #entries = new Map(); // by id
  #order = [];
  #decisions = []; // of this reviewer, the newest last, without failed ones
  #chains = new Map(); // meal -> promise of its last request
  #on;
  #retryMs;

  constructor({ send, changed = () => {}, returned = () => {}, undone = () => {}, retryMs = RETRY_MS }) {
    this.#on = { send, changed, returned, undone };
    this.#retryMs = retryMs;
    this.currentId = null;
    this.pending = 0;
  }

  // Append items {id, meal, version}, except those that are there already: an item that moved while the queue was paged
  // comes twice. Returns the new ids.
  add(items) {
    const fresh = items.filter((item) => !this.#entries.has(item.id));
    for (const item of fresh) {
      this.#entries.set(item.id, { ...item, state: "waiting", problem: null });
      this.#order.push(item.id);
    }
    if (this.currentId === null && fresh.length) this.currentId = fresh[0].id;
    return fresh.map((item) => item.id);
  }

  entry(id) {
    return this.#entries.get(id);
  }

  get current() {
    return this.#entries.get(this.currentId) ?? null;
  }

  count(...states) {
    let found = 0;
    for (const entry of this.#entries.values()) if (states.includes(entry.state)) found += 1;
    return found;
  }

  // The next items, the nearest first.
  upcoming(most) {
    const start = this.#order.indexOf(this.currentId);
    return this.#order.slice(start + 1).filter((id) => OPEN.has(this.entry(id).state)).slice(0, most);
  }

  canUndo() {
    return this.#decisions.length > 0;
  }

  // words: {kind, ...} as in the events' form, of one decision: a food and its amount are two, saved and undone together.
  decide(id, ...words) {
    const entry = this.entry(id);
    const decision = { entry, words: words.map((word) => ({ id: newId(), ...word })), isFailed: false };
    entry.state = "sent";
    entry.problem = null;
    this.#decisions.push(decision);
    this.#inTurn(entry.meal, () => this.#carryOut(decision));
    this.#goOn(id);
    this.#on.changed();
    return decision;
  }

  // An event that decides nothing, such as a comment. Resolves when it is saved.
  remark(id, word) {
    const entry = this.entry(id);
    return this.#inTurn(entry.meal, () => this.#deliver(entry, { id: newId(), ...word }));
  }

  // Skip the item without an event: it comes again when the queue starts over.
  skip(id) {
    this.entry(id).state = "skipped";
    this.#goOn(id);
    this.#on.changed();
  }

  // Undo the last decision and show its item; the shown item waits. Returns the item's entry, or null.
  undo() {
    const decision = this.#decisions.pop();
    if (!decision) return null;
    const { entry } = decision;
    entry.state = "waiting";
    entry.problem = null;
    this.currentId = entry.id;
    this.#inTurn(entry.meal, async () => {
      if (decision.isFailed) return; // it was never saved; its item is already back
      try {
        for (const word of decision.words.toReversed()) await this.#deliver(entry, { id: newId(), kind: "undo", event: word.id });
        this.#on.undone(entry, null);
      } catch (problem) {
        entry.problem = problem;
        this.#on.undone(entry, problem);
      }
    });
    this.#on.changed();
    return entry;
  }

  // Go to the next or previous item, whether or not it was decided.
  step(direction) {
    const shown = this.#order.filter((id) => this.entry(id).state !== "gone");
    const here = shown.indexOf(this.currentId);
    const found = here === -1 ? (direction < 0 ? shown.at(-1) : undefined) : shown[here + direction];
    if (found === undefined) return false;
    this.currentId = found;
    this.#on.changed();
    return true;
  }

  // Somebody else has decided it, or it no longer exists: it is not shown again.
  drop(id) {
    this.entry(id).state = "gone";
    this.entry(id).problem = null;
    if (this.currentId === id) this.#goOn(id);
    this.#on.changed();
  }

  // Go to the next waiting item; at the end, to those before it.
  #goOn(from) {
    const at = this.#order.indexOf(from);
    const round = [...this.#order.slice(at + 1), ...this.#order.slice(0, at)];
    this.currentId = round.find((id) => OPEN.has(this.entry(id).state)) ?? null;
  }

  // Read an item again after all events of its meal were sent: work() resolves to its version.
  read(id, work) {
    const { meal } = this.entry(id);
    return this.#inTurn(meal, async () => (this.entry(id).version = await work()), 0);
  }

  #inTurn(meal, work, words = 1) {
    this.pending += words;
    const done = (this.#chains.get(meal) ?? Promise.resolve()).then(work).finally(() => {
      this.pending -= words;
      if (words) this.#on.changed();
    });
    this.#chains.set(meal, done.catch(() => {}));
    return done;
  }

  async #carryOut(decision) {
    const { entry } = decision;
    try {
      for (const word of decision.words) await this.#deliver(entry, word);
      if (entry.state === "sent") entry.state = "decided";
    } catch (problem) {
      decision.isFailed = true;
      this.#decisions = this.#decisions.filter((other) => other !== decision);
      this.#bringBack(entry, problem);
      this.#on.returned(entry, decision, problem);
    }
  }

  // After the shown item, so that no key meant for that one applies to this one; at once, if none is shown.
  #bringBack(entry, problem) {
    entry.state = "waiting";
    entry.problem = problem;
    if (this.currentId === null) this.currentId = entry.id;
    if (this.currentId === entry.id) return;
    this.#order = this.#order.filter((id) => id !== entry.id);
    this.#order.splice(this.#order.indexOf(this.currentId) + 1, 0, entry.id);
  }

  // Send the same event with the same id until there is a response: repeated, it is still one event.
  async #deliver(entry, word) {
    const version = entry.version;
    for (let tried = 0; ; tried += 1) {
      try {
        const answer = await this.#on.send(entry, { ...word, version });
        for (const other of this.#entries.values()) {
          if (other.meal === entry.meal && other.version === version) other.version = answer.version;
        }
        return answer;
      } catch (problem) {
        if (!problem.retryable || tried >= this.#retryMs.length) throw problem;
        await pause(this.#retryMs[tried]);
      }
    }
  }
}

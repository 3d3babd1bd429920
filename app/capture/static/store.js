// The phone's store: its enrolment, its meals and their photographs, in IndexedDB. A photograph's bytes are deleted
// only by `markDurable`, that is after the server said that it has them on its disk, and where the person deletes them.
//
// A record is a meal's pair, its after-meal pair, or what the person confirmed of it without a network: {id, meal, part, owner, state, captured_at, time_zone, created_ms, slots,
//   durable, comment, all_eaten, is_announced, tries, waited_from_ms, next_try_ms, problem, thumbnail, first_board, is_note_refused}
//   id: the meal's, made on this phone; of an after-meal pair "ID/after", of confirmations "ID/review". meal: the meal's id
//   part: "meal", "after" or "review"; this one has events, to be sent in their order, and the meal's version that they are about
//   owner: the participant who took it: a phone that is enrolled anew for somebody else sends only that person's meals
//   state: "draft" (being photographed), "waiting" (to be sent), "refused" (the server cannot accept it), "sent"
//   slots: the photographs that belong to it; durable: those of them that the server has on its disk
//   comment: {id, text} to be sent as an event, or null; all_eaten: {id} of the event `nothing_left`, or null
//   problem: {code, detail} of the last try, or null; thumbnail: {bytes, type}, or null

const NAME = "tada-capture";
const VERSION = 1;
const KEY = "phone";
const JOINING = "joining";
const channel = new BroadcastChannel(NAME);

/** @type {Promise<IDBDatabase> | null} */
let opened = null;

/** Call `listener` after each change of the store, also by another tab or the service worker, until `signal` aborts. */
export function onChange(listener, signal) {
  channel.addEventListener("message", listener, { signal });
  changes.addEventListener("change", listener, { signal });
}
const changes = new EventTarget();

/** The enrolment: {server, token, participant, study, name, marker, locale, ...}, or undefined. */
export const phone = () => read("phone", (store) => store.get(KEY));

export const savePhone = (values) => write(["phone"], (stores) => stores.phone.put(values, KEY));

/** An attempt to join whose answer has not come: {code, secret}, or undefined. The same again gets the same token. */
export const joining = () => read("phone", (store) => store.get(JOINING));

export const saveJoining = (values) => write(["phone"], (stores) => stores.phone.put(values, JOINING));

export const endJoining = () => write(["phone"], (stores) => stores.phone.delete(JOINING));

/** Change the enrolment if it still is the one with this token; another person may have joined meanwhile. */
export const changePhone = (token, change) =>
  write(["phone"], (stores) => {
    stores.phone.get(KEY).onsuccess = ({ target }) => {
      if (target.result?.token === token) stores.phone.put(change(target.result), KEY);
    };
  });

/** Who the meals of an enrolment belong to. */
export const ownerOf = (phone) => (phone ? `${phone.server}|${phone.study}|${phone.participant}` : null);

/** Every meal, the newest first. */
export async function meals() {
  const all = await read("meals", (store) => store.getAll());
  return all.sort((a, b) => b.created_ms - a.created_ms);
}

export const meal = (id) => read("meals", (store) => store.get(id));

/** The bytes of a photograph as {bytes: ArrayBuffer, type}, or undefined. */
export const photograph = (id, slot) => read("photographs", (store) => store.get([id, slot]));

/** A kept photograph or thumbnail as a Blob. Bytes are kept rather than Blobs, which some private windows refuse. */
export const blobOf = ({ bytes, type }) => new Blob([bytes], { type });

/** A Blob as `blobOf` reads it. */
export const keptBlob = async (blob) => blob && { bytes: await blob.arrayBuffer(), type: blob.type };

/**
 * Write a draft, and photographs {slot: Blob} with it, in one transaction: after a crash there are both or neither.
 * The bytes of slots that it no longer has are deleted.
 * Returns false, and writes nothing, if the stored record is in none of the states `replaced`: another tab has sent the
 * draft meanwhile.
 */
export async function saveDraft(draft, photographs = {}, replaced = ["draft"]) {
  const kept = await Promise.all(
    Object.entries(photographs).map(async ([slot, blob]) => ({ meal: draft.id, slot, ...(await keptBlob(blob)) })),
  );
  let isSaved = false;
  await write(["meals", "photographs"], (stores) => {
    stores.meals.get(draft.id).onsuccess = ({ target }) => {
      if (target.result && !replaced.includes(target.result.state)) return;
      isSaved = true;
      for (const slot of target.result?.slots ?? []) if (!draft.slots.includes(slot)) stores.photographs.delete([draft.id, slot]);
      stores.meals.put(draft);
      for (const photograph of kept) stores.photographs.put(photograph);
    };
  });
  return isSaved;
}

/** Change a meal as it is in the store now; without one, or if `change` returns false, nothing happens. */
export async function changeMeal(id, change) {
  let changed;
  await write(["meals"], (stores) => {
    stores.meals.get(id).onsuccess = (event) => {
      changed = event.target.result;
      if (!changed || change(changed) === false) changed = undefined;
      else stores.meals.put(changed);
    };
  });
  return changed;
}

/** Add an event to the record of its meal's confirmations, or to `first` if there is none yet. */
export const addEvent = (first, event) =>
  write(["meals"], (stores) => {
    stores.meals.get(first.id).onsuccess = ({ target }) => {
      const record = target.result ?? first;
      stores.meals.put({ ...record, events: [...record.events, event] });
    };
  });

/** Note that an event was sent, and the meal's version since then. Without further events its record is deleted. */
export const dropEvent = (id, sent, version) =>
  write(["meals"], (stores) => {
    stores.meals.get(id).onsuccess = ({ target }) => {
      const events = (target.result?.events ?? []).filter((event) => event.id !== sent.id);
      if (events.length) stores.meals.put({ ...target.result, events, version });
      else stores.meals.delete(id);
    };
  });

/** Note that the server has these photographs on its disk, and delete their bytes here. */
export async function markDurable(id, slots) {
  await write(["meals", "photographs"], (stores) => {
    stores.meals.get(id).onsuccess = (event) => {
      const meal = event.target.result;
      if (!meal) return;
      meal.durable = [...new Set([...meal.durable, ...slots])];
      stores.meals.put(meal);
      for (const slot of slots) stores.photographs.delete([id, slot]);
    };
  });
}

/** Delete the voice note of a meal, which the server has refused, and note that for the person. */
export const dropNote = (id, slot) =>
  write(["meals", "photographs"], (stores) => {
    stores.meals.get(id).onsuccess = ({ target }) => {
      const meal = target.result;
      if (!meal) return;
      stores.meals.put({ ...meal, slots: meal.slots.filter((other) => other !== slot), is_note_refused: true });
      stores.photographs.delete([id, slot]);
    };
  });

/** Delete a record and its photographs here; with `state`, only if it is in that state. */
export const deleteMeal = (id, state) =>
  write(["meals", "photographs"], (stores) => {
    stores.meals.get(id).onsuccess = ({ target }) => {
      if (state && target.result?.state !== state) return;
      remove(stores, id);
    };
  });

/** Delete here a meal that the server has erased: also its after-meal pair, its confirmations, and all photographs. */
export const eraseMeal = (meal) =>
  write(["meals", "photographs"], (stores) => {
    for (const id of [meal, `${meal}/after`, `${meal}/review`]) remove(stores, id);
  });

/**
 * Delete an enrolment and all that its owner took: the person has left, which `ended` says, or signed out. Nothing is
 * deleted if the same person has joined with another token meanwhile.
 */
export const deleteOwner = (phone, ended = null) =>
  write(["phone", "meals", "photographs"], (stores) => {
    const owner = ownerOf(phone);
    stores.phone.get(KEY).onsuccess = ({ target }) => {
      const isOwners = ownerOf(target.result) === owner;
      if (isOwners && target.result.token && target.result.token !== phone.token) return;
      if (isOwners) stores.phone.delete(KEY);
      if (ended && (isOwners || !target.result)) stores.phone.put(ended, KEY);
      stores.meals.getAll().onsuccess = ({ target }) => {
        for (const meal of target.result) if (meal.owner === owner) remove(stores, meal.id);
      };
    };
  });

function remove(stores, id) {
  stores.meals.delete(id);
  stores.photographs.delete(IDBKeyRange.bound([id], [id, []]));
}

/** Ask the browser once, when the person has joined, not to evict the store: some browsers then ask the person. */
export const askToPersist = () => navigator.storage?.persist?.();

/** {persisted, free_bytes}: whether the browser keeps the store, and how much fits; null where it does not say. */
export async function room() {
  const { storage } = navigator;
  const estimate = await storage?.estimate?.();
  return { persisted: (await storage?.persisted?.()) ?? null, free_bytes: estimate ? estimate.quota - estimate.usage : null };
}

function open() {
  opened ??= new Promise((resolve, reject) => {
    const request = indexedDB.open(NAME, VERSION);
    request.onupgradeneeded = () => {
      request.result.createObjectStore("phone");
      request.result.createObjectStore("meals", { keyPath: "id" });
      request.result.createObjectStore("photographs", { keyPath: ["meal", "slot"] });
    };
    request.onsuccess = () => {
      request.result.onversionchange = () => {
        request.result.close(); // a newer page in another tab
        opened = null;
      };
      request.result.onclose = () => (opened = null);
      resolve(request.result);
    };
    request.onerror = () => reject(request.error);
  });
  opened.catch(() => (opened = null));
  return opened;
}

async function read(name, ask) {
  const database = await open();
  return new Promise((resolve, reject) => {
    const request = ask(database.transaction(name).objectStore(name));
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}

// Resolves when the transaction is complete. "strict": flushed to the disk, so that a dead battery takes no meal.
async function write(names, change) {
  const database = await open();
  await new Promise((resolve, reject) => {
    const transaction = database.transaction(names, "readwrite", { durability: "strict" });
    transaction.oncomplete = resolve;
    transaction.onabort = () => reject(transaction.error ?? new DOMException("The transaction was aborted.", "AbortError"));
    change(Object.fromEntries(names.map((name) => [name, transaction.objectStore(name)])));
  });
  channel.postMessage("change"); // other tabs and the service worker
  changes.dispatchEvent(new Event("change"));
}

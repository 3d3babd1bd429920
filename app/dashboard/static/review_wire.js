// Requests of the review page: events of an item, and cards as the server renders them.

const KEEPALIVE_BYTES = 60_000; // browsers' limit for requests that outlive a page

class Problem extends Error {
  constructor({ status = 0, code = "no_answer", message, retryable = false }) {
    super(message);
    Object.assign(this, { status, code, retryable });
  }
}

const QUESTION = "nobody eats so much of one food, or the photographs show far more or less. Is the amount right?";
const NO_ANSWER = "The server does not answer. Nothing was changed; it was tried several times.";

async function ask(address, options) {
  try {
    return await fetch(address, options);
  } catch {
    throw new Problem({ message: NO_ANSWER, retryable: true });
  }
}

// Sends an event of the card's item: resolves to the meal's new {version}. Rejects with a Problem.
export async function sendWord(card, word) {
  const fields = { ...word, seen: card.dataset.seen };
  if (word.kind !== "undo") fields.item = card.dataset.item;
  const body = new URLSearchParams(fields);
  const answer = await ask(card.dataset.events, {
    method: "POST",
    body,
    headers: { Accept: "application/json" },
    keepalive: body.toString().length < KEEPALIVE_BYTES,
  });
  const told = await answer.json().catch(() => ({}));
  if (answer.ok && Number.isInteger(told.version)) return { version: told.version };
  if (told.code === "implausible_amount" && confirm(`${card.dataset.title}: ${QUESTION}`)) return sendWord(card, { ...word, accepts: "yes" });
  throw new Problem({
    status: answer.status,
    code: told.code,
    message: told.detail ?? told.title ?? `The server answered ${answer.status}.`,
    retryable: told.retryable === true || [502, 503, 504].includes(answer.status),
  });
}

// Fetches a part of a page as a document in which no script runs. Rejects with a Problem.
export async function fetchPart(address) {
  const answer = await ask(address, { headers: { Accept: "text/html", "HX-Request": "true" } });
  if (answer.headers.has("HX-Redirect")) {
    throw new Problem({ status: 401, code: "unauthenticated", message: "The session has ended." });
  }
  const part = new DOMParser().parseFromString(await answer.text(), "text/html");
  if (answer.ok) return part;
  throw new Problem({ status: answer.status, message: part.body.textContent.replace(/\s+/g, " ").trim() });
}

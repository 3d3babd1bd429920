// The page's texts in the study's language: texts/en.json and so on, all with the same keys.

export const LANGUAGES = ["en", "de", "es", "zh"];
const loaded = new Map(); // language -> promise of its texts

/** The best of LANGUAGES for a list of wishes such as ["de-AT", "fr"]. */
export function bestLanguage(wishes) {
  const wished = wishes.filter(Boolean).map((wish) => wish.toLowerCase().split("-")[0]);
  return wished.find((language) => LANGUAGES.includes(language)) ?? "en";
}

/** Load a language. Returns t(key, {name: value}), which replaces {name} in the text. */
export async function loadTexts(language) {
  if (!loaded.has(language)) loaded.set(language, readTexts(language));
  const texts = await loaded.get(language).catch((error) => {
    loaded.delete(language); // the next call asks the server again
    throw error;
  });
  document.documentElement.lang = language;
  return (key, values = {}) => {
    if (!(key in texts)) throw new Error(`There is no text ${key} in ${language}.`);
    return texts[key].replace(/\{(\w+)\}/g, (_, name) => values[name]);
  };
}

async function readTexts(language) {
  const response = await fetch(new URL(`texts/${language}.json`, import.meta.url));
  if (!response.ok) throw new Error(`The server does not give the texts in ${language} (${response.status}).`);
  return response.json();
}

/**
 * A sentence for the person about an error, or about a record's problem {code, detail}; a refusal's reason is the server's
 * own. Only the server's errors have a code that is text ("internal": a record's of an error on the phone).
 */
export function sentenceOf(error, t) {
  const { name, code, retryable, detail, message } = error ?? {};
  if (name === "QuotaExceededError") return t("storage_full");
  if (name === "NetworkError" || code === "network") return t("needs_network");
  if (code === "clock_differs") return t("problem_clock");
  if (code === "precondition_failed") return t("changed_meanwhile");
  if (typeof code !== "string" || code === "internal") return t("problem_phone", { detail: detail ?? message ?? String(error) });
  return retryable ? t("problem_busy") : t("problem_other", { detail });
}

/** Show an error's sentence in an element; that there is no network is a quiet line, no alarm. */
export function showSentence(element, error, t) {
  element.textContent = sentenceOf(error, t);
  element.classList.toggle("offline", error?.name === "NetworkError");
}

// The editors of the review page: one at a time, in the shown card; Esc leaves, Enter saves.

import { foodSearch } from "./review_food.js";

const MOST = 20_000; // grams or millilitres, as in the API

// Reads a number, also with a comma ("120,5"); null if it is none, or may be thousands ("1,500").
export function typedNumber(text) {
  if (/[1-9]\d*,\d{3}$/.test(text.trim())) return null;
  const plain = text.trim().replace(/\s/g, "").replace(",", ".");
  if (!/^\d*\.?\d+$|^\d+\.$/.test(plain)) return null;
  const value = Number(plain);
  return value > 0 && value <= MOST ? value : null;
}

export function editors(root, { foods, say }) {
  const forms = Object.fromEntries([...root.querySelectorAll("[data-editor]")].map((form) => [form.dataset.editor, form]));
  let taken = () => {};
  const input = forms.food.querySelector("input");
  const search = foodSearch(input, root.querySelector("#review-foods"), foods, (key, name) => {
    close();
    taken("food", { key, name });
  });

  function close() {
    for (const form of Object.values(forms)) {
      if (form.hidden) continue;
      form.hidden = true;
      root.append(form); // outside of the card, which may be replaced
    }
    search.close();
  }

  // The card was replaced while typing: move the field to the new one.
  function moveTo(card) {
    const form = Object.values(forms).find((one) => !one.hidden);
    if (!form) return false;
    const field = document.activeElement;
    card.querySelector("[data-editor-place]").append(form);
    if (form.contains(field)) field.focus();
    return true;
  }

  // onTaken(editor, value): called with the entered value.
  function open(name, card, onTaken) {
    close();
    taken = onTaken;
    const form = forms[name];
    card.querySelector("[data-editor-place]").append(form);
    form.hidden = false;
    if (name === "food") input.value = "";
    if (name === "mass" || name === "volume") {
      const value = card.dataset[name];
      form.querySelector("input").value = value === "" ? "" : String(Number(Number(value).toPrecision(4)));
    }
    if (name === "comment") form.querySelector("textarea").value = "";
    const field = form.querySelector("input, textarea");
    field?.focus();
    field?.select();
    form.scrollIntoView({ block: "nearest" });
  }

  for (const name of ["mass", "volume"]) {
    forms[name].addEventListener("submit", (event) => {
      event.preventDefault();
      const field = forms[name].querySelector("input");
      const value = typedNumber(field.value);
      field.setAttribute("aria-invalid", String(value === null));
      if (value === null) {
        say(`A number above 0 and at most ${MOST}: “${field.value}” is none.`);
        field.select();
        return;
      }
      const of = forms[name].querySelector("select")?.value;
      close();
      taken(name, name === "mass" ? { mass_g: String(value), of } : { volume_ml: String(value) });
    });
    // Enter sends a form with one field; with two it would need a button, for which there is no room
    forms[name].addEventListener("keydown", (event) => {
      if (event.key !== "Enter" || event.repeat) return;
      event.preventDefault();
      forms[name].requestSubmit();
    });
  }
  forms.food.addEventListener("submit", (event) => event.preventDefault());
  forms.comment.addEventListener("submit", (event) => {
    event.preventDefault();
    const text = forms.comment.querySelector("textarea").value.trim();
    if (text) taken("comment", { text });
  });
  forms.comment.addEventListener("keydown", (event) => {
    if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) {
      event.preventDefault();
      forms.comment.requestSubmit();
    }
  });
  return { open, close, moveTo };
}

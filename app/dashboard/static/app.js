// Scripts of every page: the choice of light or dark, and messages for failed htmx requests.

const root = document.documentElement;

function isDark() {
  return root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

document.addEventListener("click", (event) => {
  if (!event.target.closest("[data-theme-toggle]")) return;
  root.dataset.theme = isDark() ? "light" : "dark";
  localStorage.setItem("tada-theme", root.dataset.theme);
  document.dispatchEvent(new CustomEvent("tada:theme"));
});

// without a response htmx has nothing to swap in
document.addEventListener("htmx:error", () => {
  const place = document.getElementById("problem");
  if (!place) return;
  const line = document.createElement("p");
  line.className = "refused";
  line.textContent = "The server does not answer. Nothing was changed; try again in a moment.";
  place.replaceChildren(line);
});

document.addEventListener("htmx:before:request", () => document.getElementById("problem")?.replaceChildren());

// <select data-submit> and others: a filter is applied when it is chosen
document.addEventListener("change", (event) => {
  if (event.target.matches("[data-submit]")) event.target.form?.requestSubmit();
});

// keep empty fields of a filter out of the address
document.addEventListener("submit", (event) => {
  if (!event.target.matches("form[data-filters]")) return;
  const fields = [...event.target.elements].filter((field) => field.name && field.value === "" && !field.disabled);
  for (const field of fields) field.disabled = true;
  setTimeout(() => fields.forEach((field) => (field.disabled = false))); // after the form's data were collected: the page may stay
});
addEventListener("pageshow", () => {
  for (const field of document.querySelectorAll("form[data-filters] :disabled")) field.disabled = false;
});

// <form data-confirm="...">: asks before it is sent
document.addEventListener("submit", (event) => {
  const question = event.target.dataset.confirm;
  if (question && !confirm(question)) event.preventDefault();
});

// <button data-ask="...">: asks before its form is sent
document.addEventListener("click", (event) => {
  const button = event.target.closest("[data-ask]");
  if (button && !confirm(button.dataset.ask)) event.preventDefault();
});

// <input type="checkbox" data-check-all>: marks all of its form
document.addEventListener("change", (event) => {
  if (!event.target.matches("[data-check-all]")) return;
  for (const box of event.target.form.querySelectorAll("td input[type=checkbox]")) box.checked = event.target.checked;
});

// with Shift, a checkbox of a table marks all from the last one that was clicked
let lastBox = null;
document.addEventListener("click", (event) => {
  if (!event.target.matches("td input[type=checkbox]")) return;
  const boxes = [...event.target.closest("table").querySelectorAll("td input[type=checkbox]")];
  const ends = [boxes.indexOf(lastBox), boxes.indexOf(event.target)].sort((a, b) => a - b);
  if (event.shiftKey && ends[0] >= 0) for (const box of boxes.slice(ends[0], ends[1])) box.checked = event.target.checked;
  lastBox = event.target;
});

// <button data-print>
document.addEventListener("click", (event) => {
  if (event.target.closest("[data-print]")) print();
});

// <button data-copy="text">
document.addEventListener("click", async (event) => {
  const button = event.target.closest("[data-copy]");
  if (!button) return;
  await navigator.clipboard.writeText(button.dataset.copy);
  const label = button.textContent;
  button.textContent = "Copied";
  setTimeout(() => (button.textContent = label), 1500);
});

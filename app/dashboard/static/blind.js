// The blind review's keys: each element with data-key is chosen, focused or pressed by one of its keys.

const letters = document.querySelector("[data-shortcuts-on]");
if (letters) {
  letters.checked = localStorage.getItem("tada-review-letters") !== "off";
  letters.addEventListener("change", () => localStorage.setItem("tada-review-letters", letters.checked ? "on" : "off"));
}

document.addEventListener("keydown", (event) => {
  const { target, key } = event;
  if (event.defaultPrevented || event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
  if (target.matches("input:not([type=radio], [type=checkbox]), select, textarea")) {
    if (key === "Escape") target.blur();
    return;
  }
  if (key === "Enter" ? target.closest("a, button") : letters && !letters.checked) return;
  const element = [...document.querySelectorAll("[data-key]")].find((one) => one.dataset.key.split(" ").includes(key));
  if (!element) return;
  event.preventDefault();
  if (element.matches("input:not([type=radio])")) element.select();
  else element.click();
});

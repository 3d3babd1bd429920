// The review page's keys: their actions, and when a key is ignored because it was meant for something else.

const KEYS = {
  Enter: "confirm", ArrowDown: "candidate", ArrowUp: "candidateBefore",
  y: "confirm", n: "candidate", f: "food", "/": "food", m: "mass", v: "volume", d: "draw", x: "reject", s: "skip",
  c: "comment", u: "undo", o: "open", k: "previous", j: "next", "?": "help",
};
const REPEATED = new Set(["candidate", "candidateBefore", "previous", "next"]); // actions that a held key repeats
const NO_LETTERS = new Set(["Enter", "ArrowDown", "ArrowUp"]); // keys that work while letters are switched off
const SETTLE_MS = 150; // an earlier key press was meant for the previous card

// cards: Cards. act(action); choose(button): a choice by its number; leave(): Escape.
export function followKeys(root, { cards, act, choose, leave }) {
  const isOn = root.querySelector("[data-shortcuts-on]");

  function isForOthers(event) {
    const { target, key } = event;
    if (target.closest("input, select, textarea, [contenteditable]")) return true;
    if (key === "Enter") return target.closest("a, button, summary, [role=option]") !== null; // Enter activates it, not the card's action
    if (!key.startsWith("Arrow")) return !isOn.checked;
    const isAtCard = target === document.body || target.closest("[data-item]") !== null;
    return !isAtCard || !cards.shown?.querySelector(".choice"); // the key scrolls the page
  }

  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    if (event.key === "Escape") {
      leave();
      return;
    }
    if (isForOthers(event)) return;
    if (event.key === "Enter" && cards.isAtEnd) {
      if (!event.repeat) root.querySelector("[data-round]").click();
      return;
    }
    const choice = /^[1-9]$/.test(event.key) ? cards.shown?.querySelector(`.choice[data-key="${event.key}"]`) : null;
    const action = KEYS[event.key];
    if (!choice && !action) return;
    event.preventDefault();
    if (event.repeat && !REPEATED.has(action)) return;
    if (performance.now() - cards.shownAt < SETTLE_MS && !REPEATED.has(action)) return;
    if (choice) choose(choice);
    else act(action);
  });

  // single letters can be switched off (WCAG 2.1.4); Enter still works as on any button, arrows as in any list
  function applyShortcuts() {
    localStorage.setItem("tada-review-letters", isOn.checked ? "on" : "off");
    for (const button of root.querySelectorAll("[data-shortcuts]")) {
      const keys = button.dataset.shortcuts.split(" ").filter((key) => isOn.checked || NO_LETTERS.has(key));
      if (keys.length) button.setAttribute("aria-keyshortcuts", keys.join(" "));
      else button.removeAttribute("aria-keyshortcuts");
    }
    root.classList.toggle("no-letters", !isOn.checked);
  }
  isOn.checked = localStorage.getItem("tada-review-letters") !== "off";
  isOn.addEventListener("change", applyShortcuts);
  applyShortcuts();
}

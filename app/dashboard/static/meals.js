// The list of meals: foods are searched while typing; unfinished meals are polled only while the page is visible.
import "./combobox.js";

const BRISK = 8; // polls in a row without a change before they become rarer: half a minute
const LONGEST = 6; // maximum number of skipped ticks: 28 seconds between polls
let quiet = 0; // polls since the last change, or since the page became visible
let passed = 0; // ticks since the last poll

// htmx ticks every four seconds: photographs that are missing for hours need no poll at each tick, and a hidden tab
// needs none
document.addEventListener(
  "every",
  (event) => {
    if (event.target.id !== "meals-watch") return;
    const rest = quiet < BRISK ? 0 : Math.min(2 ** (quiet - BRISK + 1) - 1, LONGEST);
    if (document.hidden || passed < rest) {
      passed += 1;
      event.stopImmediatePropagation();
      return;
    }
    quiet += 1;
    passed = 0;
  },
  true,
);
document.addEventListener("htmx:after:request", (event) => {
  const { sourceElement, response } = event.detail.ctx;
  if (sourceElement.id === "meals-watch" && response.status === 200) quiet = 0;
});
document.addEventListener("visibilitychange", () => (quiet = 0));

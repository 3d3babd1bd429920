// The list of meals: foods are searched as one types; what is under way is asked for only while somebody looks.
import "./combobox.js";

const BRISK = 8; // questions in a row that nothing has changed at: half a minute of them
const LONGEST = 6; // most ticks that are passed over: 28 seconds from one question to the next
let quiet = 0; // questions since something has changed, or since somebody looked again
let passed = 0; // ticks since the last one

// htmx ticks every four seconds: photographs that do not come for hours need not be asked for at each tick, and in a
// tab that nobody sees nothing need be
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

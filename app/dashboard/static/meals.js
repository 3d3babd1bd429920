// The list of meals: foods are searched as one types; what is under way is asked for only while somebody looks.
import "./combobox.js";

// htmx asks every few seconds; in a tab that nobody sees it need not, and one hears of it as soon as one looks again
document.addEventListener(
  "every",
  (event) => {
    if (document.hidden && event.target.id === "meals-watch") event.stopImmediatePropagation();
  },
  true,
);

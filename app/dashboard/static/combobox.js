// Foods as options of a combobox (<div class="combobox" data-foods="...">): searched while typing, chosen by key or mouse.
// A form is not sent with text for which no food was chosen; text that is exactly one food's key or name chooses it.

let search; // the running request

// Shows the server's matches; returns whether it answered, which an aborted search did not.
async function offer(box, input, list) {
  search?.abort();
  search = new AbortController();
  const words = input.value.trim();
  try {
    if (words) {
      const answer = await fetch(`${box.dataset.foods}&q=${encodeURIComponent(words.slice(0, 100))}`, {
        headers: { Accept: "text/html", "HX-Request": "true" },
        signal: search.signal,
      });
      if (answer.ok) {
        const page = new DOMParser().parseFromString(await answer.text(), "text/html");
        list.replaceChildren(...page.body.childNodes);
        list.hidden = false;
        input.setAttribute("aria-expanded", "true");
        return true;
      }
    }
    close(input, list);
  } catch (error) {
    if (error.name !== "AbortError") close(input, list);
  }
  return false;
}

function close(input, list) {
  list.hidden = true;
  list.replaceChildren();
  input.setAttribute("aria-expanded", "false");
  input.removeAttribute("aria-activedescendant");
}

function mark(input, option) {
  for (const one of option.parentElement.children) one.setAttribute("aria-selected", String(one === option));
  input.setAttribute("aria-activedescendant", option.id);
  option.scrollIntoView({ block: "nearest" });
}

function choose(box, option) {
  const input = box.querySelector("[role=combobox]");
  input.value = option.dataset.name;
  box.querySelector("input[name=food]").value = option.dataset.key;
  say(input, "");
  close(input, box.querySelector("[role=listbox]"));
}

// Returns what is wrong with the text; "" if nothing.
function say(input, sentence) {
  input.setCustomValidity(sentence);
  if (sentence) input.setAttribute("aria-invalid", "true");
  else input.removeAttribute("aria-invalid");
}

// Returns the only food whose key or name is the text; undefined for none or several.
function named(words, list) {
  const wanted = words.toLowerCase();
  const same = [...list.querySelectorAll("[role=option]")].filter((option) =>
    [option.dataset.key, option.dataset.name].some((text) => text.toLowerCase() === wanted),
  );
  return same.length === 1 ? same[0] : undefined;
}

// Returns the boxes of a form that have text but no food yet.
function undecided(form) {
  return [...form.querySelectorAll(".combobox[data-foods]")].filter(
    (box) => box.querySelector("[role=combobox]").value.trim() && !box.querySelector("input[name=food]").value,
  );
}

// Chooses the food that the text names, or reports that none was chosen; returns whether one was.
async function settle(box) {
  const input = box.querySelector("[role=combobox]");
  const list = box.querySelector("[role=listbox]");
  const words = input.value.trim();
  const answered = await offer(box, input, list);
  if (input.value.trim() !== words) return false; // the text has changed: the user sends the form again
  const food = answered ? named(words, list) : undefined;
  if (food) {
    choose(box, food);
    return true;
  }
  const offered = list.querySelector("[role=option]");
  say(
    input,
    !answered
      ? "The foods could not be searched: try again in a moment."
      : offered
        ? "Choose a food from the list."
        : "No food of the tables matches this.",
  );
  input.reportValidity();
  return false;
}

const settling = new WeakSet(); // forms that wait for a response: sent once, however often the key is pressed
document.addEventListener(
  "submit",
  async (event) => {
    const form = event.target;
    const boxes = undecided(form);
    if (!boxes.length) return;
    event.preventDefault();
    event.stopImmediatePropagation(); // before htmx and the confirmation handle it
    if (settling.has(form)) return;
    settling.add(form);
    clearTimeout(typing);
    const { submitter } = event;
    try {
      for (const box of boxes) if (!(await settle(box))) return;
    } finally {
      settling.delete(form);
    }
    form.requestSubmit(submitter);
  },
  true,
);

// Validity is reset at each attempt: a browser does not send an invalid form, nor tells a script
document.addEventListener(
  "click",
  (event) => {
    const form = event.target.closest("button")?.form; // also clicked by Enter in a field
    for (const input of form?.querySelectorAll(".combobox[data-foods] [role=combobox]") ?? []) say(input, "");
  },
  true,
);

let typing;
document.addEventListener("input", (event) => {
  const input = event.target;
  const box = input.closest(".combobox");
  if (!box || !input.matches("[role=combobox]")) return;
  box.querySelector("input[name=food]").value = ""; // the text is no longer the chosen food
  say(input, "");
  clearTimeout(typing);
  typing = setTimeout(() => offer(box, input, box.querySelector("[role=listbox]")), 180);
});

document.addEventListener("keydown", (event) => {
  const input = event.target;
  if (!input.matches?.(".combobox [role=combobox]")) return;
  const box = input.closest(".combobox");
  const list = box.querySelector("[role=listbox]");
  if (list.hidden) return;
  const options = [...list.querySelectorAll("[role=option]")];
  const at = options.findIndex((one) => one.getAttribute("aria-selected") === "true");
  if (event.key === "ArrowDown" || event.key === "ArrowUp") {
    event.preventDefault();
    const step = event.key === "ArrowDown" ? 1 : -1;
    if (options.length) mark(input, options[(at + step + options.length + (at < 0 && step < 0 ? 1 : 0)) % options.length]);
  } else if (event.key === "Enter" && at >= 0) {
    event.preventDefault();
    choose(box, options[at]);
  } else if (event.key === "Escape") {
    event.preventDefault();
    close(input, list);
  }
});

document.addEventListener("mousedown", (event) => {
  const option = event.target.closest(".combobox [role=option]");
  if (!option) return;
  event.preventDefault(); // the input keeps the focus
  choose(option.closest(".combobox"), option);
});

document.addEventListener("focusout", (event) => {
  if (!event.target.matches?.(".combobox [role=combobox]")) return;
  close(event.target, event.target.closest(".combobox").querySelector("[role=listbox]"));
});

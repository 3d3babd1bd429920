// Foods as options of a combobox (<div class="combobox" data-foods="...">): searched as one types, chosen by key or mouse.

let search; // the running one

async function offer(box, input, list) {
  search?.abort();
  search = new AbortController();
  const words = input.value.trim();
  if (!words) return close(input, list);
  try {
    const answer = await fetch(`${box.dataset.foods}&q=${encodeURIComponent(words.slice(0, 100))}`, {
      headers: { Accept: "text/html", "HX-Request": "true" },
      signal: search.signal,
    });
    if (!answer.ok) return close(input, list);
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    list.replaceChildren(...page.body.childNodes);
    list.hidden = false;
    input.setAttribute("aria-expanded", "true");
  } catch (error) {
    if (error.name !== "AbortError") close(input, list);
  }
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
  close(input, box.querySelector("[role=listbox]"));
}

let typing;
document.addEventListener("input", (event) => {
  const input = event.target;
  const box = input.closest(".combobox");
  if (!box || !input.matches("[role=combobox]")) return;
  box.querySelector("input[name=food]").value = ""; // what is typed now is not what was chosen
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

// A food search: options appear while typing, arrows choose, Enter takes one.

const TYPING_MS = 120;

// input: a combobox; list: its list box. address: of the options (item_actions.py). taken(key, name): callback.
export function foodSearch(input, list, address, taken) {
  let timer = null;
  let asked = null; // the current request; older ones are aborted

  function options() {
    return [...list.querySelectorAll('[role="option"]')];
  }

  function choose(option) {
    for (const one of options()) one.setAttribute("aria-selected", String(one === option));
    if (option) {
      input.setAttribute("aria-activedescendant", option.id);
      option.scrollIntoView({ block: "nearest" });
    } else {
      input.removeAttribute("aria-activedescendant");
    }
  }

  function close() {
    asked?.abort();
    clearTimeout(timer);
    list.replaceChildren();
    input.setAttribute("aria-expanded", "false");
    choose(null);
  }

  async function ask() {
    asked?.abort();
    const mine = (asked = new AbortController());
    const words = input.value.trim();
    if (!words) {
      close();
      return;
    }
    try {
      const query = new URLSearchParams({ q: words, list: list.id });
      const answer = await fetch(`${address}?${query}`, {
        headers: { Accept: "text/html", "HX-Request": "true" },
        signal: mine.signal,
      });
      if (!answer.ok || answer.status === 204) throw new Error(String(answer.status));
      const found = new DOMParser().parseFromString(await answer.text(), "text/html");
      if (mine !== asked) return;
      list.replaceChildren(...[...found.body.childNodes].map((node) => document.importNode(node, true)));
      input.setAttribute("aria-expanded", String(options().length > 0));
      choose(options()[0] ?? null);
    } catch (error) {
      if (error.name === "AbortError") return;
      const line = document.createElement("p");
      line.className = "refused";
      line.textContent = "The foods cannot be searched now.";
      list.replaceChildren(line);
    }
  }

  input.addEventListener("input", () => {
    clearTimeout(timer);
    asked?.abort();
    choose(null); // the list is of an earlier text: Enter takes nothing
    timer = setTimeout(ask, TYPING_MS);
  });
  input.addEventListener("keydown", (event) => {
    const all = options();
    const here = all.findIndex((one) => one.getAttribute("aria-selected") === "true");
    if (event.key === "ArrowDown" || event.key === "ArrowUp") {
      if (all.length) choose(all[(here + (event.key === "ArrowDown" ? 1 : all.length - 1)) % all.length]);
      event.preventDefault();
    } else if (event.key === "Enter") {
      event.preventDefault();
      if (!event.repeat && here >= 0) taken(all[here].dataset.key, all[here].dataset.name);
    }
  });
  list.addEventListener("click", (event) => {
    const option = event.target.closest('[role="option"]');
    if (option) taken(option.dataset.key, option.dataset.name);
  });
  return { close };
}

// Elements by one function, and the parts that several pages use.

/**
 * An element: h("button", {class: "main", onclick: send}, "Send"). Properties that begin with "on" are listeners; false,
 * null and undefined leave an attribute out; children that are null or false are left out.
 */
export function h(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== false && child !== undefined));
  return element;
}

/** The same in SVG. */
export function svg(name, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

/** A button that is disabled while its action runs, so that a second tap does nothing; a failure is shown by `onError`. */
export function button(text, action, { kind = "", onError = (error) => { throw error; }, ...attributes } = {}) {
  const element = h("button", { type: "button", class: kind, ...attributes }, text);
  element.addEventListener("click", async () => {
    element.disabled = true;
    try {
      await action();
    } catch (error) {
      onError(error);
    } finally {
      element.disabled = false;
    }
  });
  return element;
}

/** An image of a blob, whose address is released once it is loaded. */
export function picture(blob, alt) {
  const image = h("img", { alt });
  image.src = URL.createObjectURL(blob);
  image.addEventListener("load", () => URL.revokeObjectURL(image.src), { once: true });
  return image;
}

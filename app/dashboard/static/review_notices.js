// Notices of failed actions, which stay until they are dismissed. Alerts, so that screen readers announce them at once.

export class Notices {
  constructor(place, signIn) {
    this.place = place;
    this.signIn = signIn;
  }

  // sentence: what happened. problem: the server's problem document. again(): offered as a button.
  add(sentence, problem = null, again = null) {
    const box = document.createElement("div");
    box.className = problem ? "refused" : "notice";
    const line = document.createElement("p");
    const strong = document.createElement("strong");
    strong.textContent = sentence;
    line.append(strong, problem ? ` ${problem.message}` : "");
    box.append(line);
    if (problem?.status === 401) {
      const link = document.createElement("a");
      link.href = this.signIn;
      link.target = "_blank";
      link.rel = "noopener";
      link.textContent = "Sign in again in another tab, then go on here.";
      box.append(link, " ");
    }
    if (again) box.append(this.#button("Try again", () => (box.remove(), again())));
    box.append(this.#button("Close", () => box.remove()));
    this.place.append(box);
  }

  #button(label, pressed) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = label;
    button.addEventListener("click", pressed);
    return button;
  }
}

// The diary: closing a day, the study's feedback on it where the study gives any, and questions of its reviewers.

import { button, h } from "../dom.js";
import { showSentence } from "../texts.js";

const DAYS = 7;
const DAY_MS = 86_400_000;

export async function showDays(main, { t, phone, client }) {
  const stop = new AbortController();
  const alert = h("p", { role: "alert" });
  const questions = h("div");
  const days = h("ol", { class: "items" });
  main.append(h("h1", {}, t("days")), h("p", {}, t("days_explain")), alert, questions, days);
  attempt(async () => {
    questions.replaceChildren(...(await client.getQuestions({ signal: stop.signal })).map(questionForm));
    await readDays();
  });
  return () => stop.abort();

  // A day that nothing was entered for is open, at version 0; one before the person joined is not asked about.
  async function readDays() {
    const dates = Array.from({ length: DAYS }, (_, back) => localDate(new Date(Date.now() - back * DAY_MS)));
    const listed = await client.getDays({ from: dates.at(-1), to: dates[0], signal: stop.signal });
    const joined = phone.joined_at ? localDate(new Date(phone.joined_at)) : dates.at(-1);
    const empty = (date) => date >= joined && { date, status: "open", ate_nothing: false, meals: 0, meals_after_closing: 0, version: 0 };
    const shown = dates.map((date) => listed.find((day) => day.date === date) ?? empty(date));
    days.replaceChildren(...shown.filter(Boolean).map(card));
  }

  function card(day) {
    const enter = (entry) => attempt(async () => {
      await client.putDay(day, entry);
      await readDays();
    });
    const entry = day.ate_nothing ? "nothing" : day.status;
    return h(
      "li",
      { "data-day": day.date, "data-status": day.status },
      h("h2", {}, new Date(`${day.date}T12:00`).toLocaleDateString(document.documentElement.lang, { weekday: "long", day: "numeric", month: "long" })),
      h("p", { class: day.status === "closed" ? "good" : null }, t(`entry_${entry}`, { meals: day.meals })),
      day.meals_after_closing ? h("p", { class: "notice" }, t("day_meals_after_closing", { count: day.meals_after_closing })) : null,
      h(
        "div",
        { class: "actions" },
        day.status === "closed" && !day.meals_after_closing ? button(t("day_reopen"), () => enter({ status: "open" })) : null,
        day.status === "open" || day.meals_after_closing ? button(t("day_close"), () => enter({ status: "closed" }), { kind: day.meals ? "main" : "" }) : null,
        day.status === "open" && !day.meals ? button(t("day_ate_nothing"), () => enter({ status: "closed", ate_nothing: true })) : null,
      ),
      phone.gives_feedback && day.meals ? feedback(day.date) : null,
    );
  }

  // Loaded when it is opened. The sentences are the server's, to be shown as they are.
  function feedback(date) {
    const content = h("div", { role: "status" });
    const details = h("details", {}, h("summary", {}, t("day_feedback")), content);
    details.addEventListener("toggle", () => details.open && attempt(async () => {
      const summary = await client.getSummary({ date, signal: stop.signal });
      content.replaceChildren(...summary.sentences.map((sentence) => h("p", {}, sentence)), h("p", { class: "who" }, summary.disclaimer));
    }));
    return details;
  }

  function questionForm(question) {
    const name = `answer-${question.id}`;
    const field = h("input", { id: name, maxlength: 500, required: true, autocomplete: "off" });
    const answer = button(t("answer"), () => field.reportValidity() && attempt(async () => {
      const meal = await client.getMeal(question.meal);
      await client.sendEvent(meal, { kind: "answer", question: question.id, text: field.value });
      form.remove();
    }), { kind: "main" });
    const form = h("section", { class: "notice" }, h("p", {}, t("question_about", { day: question.local_date })), h("label", { for: name }, question.text), field, answer);
    return form;
  }

  async function attempt(action) {
    alert.textContent = "";
    try {
      await action();
    } catch (error) {
      if (stop.signal.aborted) return;
      if (error.code === "precondition_failed") await readDays(); // somebody else was faster: show how it is now
      showSentence(alert, error, t);
    }
  }
}

const localDate = (date) => `${date.getFullYear()}-${String(date.getMonth() + 1).padStart(2, "0")}-${String(date.getDate()).padStart(2, "0")}`;

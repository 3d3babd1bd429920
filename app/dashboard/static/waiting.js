// What asks by itself rests while nobody sees the page, and asks again when it is seen.
document.addEventListener("htmx:before:request", (event) => {
  if (document.hidden && event.target.closest?.("[data-rests-hidden]")) event.preventDefault();
});

// Polling stops while the page is hidden, and continues when it is visible again.
document.addEventListener("htmx:before:request", (event) => {
  if (document.hidden && event.target.closest?.("[data-rests-hidden]")) event.preventDefault();
});

// Before the page is drawn: light or dark as last chosen here, otherwise as the system prefers.
const chosenTheme = localStorage.getItem("tada-theme");
if (chosenTheme === "light" || chosenTheme === "dark") document.documentElement.dataset.theme = chosenTheme;

// Before anything is drawn: light or dark as was last chosen here; else as the system says.
const chosenTheme = localStorage.getItem("tada-theme");
if (chosenTheme === "light" || chosenTheme === "dark") document.documentElement.dataset.theme = chosenTheme;

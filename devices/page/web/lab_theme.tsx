// Light or dark: as the system has it, until somebody chooses; the page of a session within follows.

const KEY = "theme";

function show(name: string): void {
  document.documentElement.dataset["theme"] = name;
}

function turn(): void {
  show(document.documentElement.dataset["theme"] === "dark" ? "light" : "dark");
  localStorage.setItem(KEY, document.documentElement.dataset["theme"] ?? "");
}

export const showTheme = (): void => show(localStorage.getItem(KEY) ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));

export const ThemeButton = () => <button type="button" class="theme" onClick={turn}>theme</button>;

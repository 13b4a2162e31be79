// A menu of the versions of the pages, where they are published next to each other (docs/_ext/publish.py).
document.addEventListener("DOMContentLoaded", async () => {
  const menu = document.getElementById("versions");
  if (!menu || location.protocol === "file:") return;
  const root = new URL(menu.dataset.root || "./", location.href);
  const answer = await fetch(new URL("../versions.json", root)).catch(() => null);
  if (!answer || !answer.ok) return;
  const select = menu.querySelector("select");
  const shown = root.pathname.split("/").slice(-2)[0];
  for (const name of await answer.json()) select.add(new Option(name, name, name === shown, name === shown));
  select.addEventListener("change", () => {
    location.href = new URL(`../${select.value}/index.html`, root);
  });
  menu.hidden = false;
});

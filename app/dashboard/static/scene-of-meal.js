// The scene of the meal's run, fetched once: {file, items: index in the run -> {id, number}}, or null if there is none.

let fetched; // {address, file}

export async function loadScene() {
  const element = document.getElementById("scene-of-photographs");
  if (!element) return null;
  const wanted = JSON.parse(element.textContent);
  try {
    if (fetched?.address !== wanted.scene) {
      const answer = await fetch(wanted.scene);
      if (!answer.ok) return null;
      fetched = { address: wanted.scene, file: await answer.json() };
    }
  } catch {
    return null;
  }
  return { file: fetched.file, items: wanted.items };
}

// What the page has to say: problems as the service tells them, and questions in a dialog.
import { element } from "./readout.js";

const $ = (id) => document.getElementById(id);

export function problemText(error) {
  const box = document.createDocumentFragment();
  box.append(element("strong", error.title || "Something went wrong"), element("span", error.message || error.detail || ""));
  if (error.field) box.append(element("small", `field: ${error.field}`));
  return box;
}

export function tellProblem(error) {
  console.info("problem:", error.title, error.message);
  const item = element("li"), close = element("button", "Dismiss");
  close.type = "button";
  close.addEventListener("click", () => item.remove());
  item.append(problemText(error), close);
  $("notices").append(item);
  while ($("notices").children.length > 3) $("notices").firstChild.remove();
}

// A dialog of a question with these buttons: [[value, label]…]. Resolves to the value, or `otherwise` on Escape.
export function ask(title, content, buttons, otherwise) {
  const dialog = $("question");
  dialog.querySelector("h2").textContent = title;
  dialog.querySelector(".content").replaceChildren(content);
  return new Promise((resolve) => {
    let answer = otherwise;
    dialog.querySelector(".buttons").replaceChildren(...buttons.map(([value, label, kind]) => {
      const button = element("button", label);
      button.type = "button";
      button.className = kind ?? "";
      button.addEventListener("click", () => { answer = value; dialog.close(); });
      return button;
    }));
    dialog.addEventListener("close", () => resolve(answer), { once: true });
    dialog.showModal();
  });
}

// The API key, where the service wants one; kept for this tab only.
export function askKey(problem) {
  const dialog = $("key"), input = dialog.querySelector("input");
  dialog.querySelector("p").textContent = problem.message;
  input.value = "";
  return new Promise((resolve) => {
    let key = null;
    const form = dialog.querySelector("form");
    form.onsubmit = (event) => { event.preventDefault(); key = input.value.trim() || null; dialog.close(); };
    dialog.addEventListener("close", () => resolve(key), { once: true });
    dialog.showModal();
    input.focus();
  });
}

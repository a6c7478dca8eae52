// The message above the stage: the problem that appeared last, with those before it below until they are solved.

export class Notice {
  constructor(box) {
    Object.assign(this, { box, shown: [], known: [] });
    box.querySelector("button").addEventListener("click", () => {
      this.shown.pop();
      this.show();
    });
  }

  /** Take all present problems as lines of text; those that are new are shown, those that are gone are not. */
  update(problems) {
    const fresh = problems.filter((text) => !this.known.includes(text));
    this.known = problems;
    this.shown = [...this.shown.filter((text) => problems.includes(text)), ...fresh];
    this.show();
  }

  show() {
    const text = this.shown.at(-1) ?? "";
    const line = this.box.querySelector("p");
    if (line.textContent !== text) line.textContent = text;
    this.box.hidden = !text;
  }
}

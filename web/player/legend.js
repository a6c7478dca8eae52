// What the colours of a measured result mean, with the numbers of the moment.
import { make } from "./dom.js";

const percent = (share) => `${(100 * share).toFixed(share < 0.0995 ? 1 : 0)} %`;
const number = (value) => value.toPrecision(3).replace(/\.?0+$/, "");

export class Legend {
  constructor(stage) {
    this.stage = stage;
    this.box = make("div", "legend", { hidden: true });
    this.title = this.box.appendChild(make("span", "legend-title"));
    const scale = this.box.appendChild(make("span", "legend-scale"));
    this.low = scale.appendChild(make("span", ""));
    this.strip = scale.appendChild(make("span", "legend-strip"));
    this.high = scale.appendChild(make("span", ""));
    this.words = this.box.appendChild(make("span", "legend-words"));
    stage.element.append(this.box);
    stage.addEventListener("time", () => this.show());
  }

  show() {
    const { measure } = this.stage;
    this.box.hidden = !measure;
    if (!measure) return;
    const { title, ends, words } = measure.what === "stretch" ? stretched(measure) : wrong(measure);
    this.title.textContent = title;
    this.strip.style.background = measure.css;
    [this.low.textContent, this.high.textContent] = ends;
    this.words.textContent = words;
  }

  dispose() {
    this.box.remove();
  }
}

function stretched({ limit, mean, most }) {
  return {
    title: "Edge lengths, against the identity",
    ends: [`−${percent(1 - 1 / limit)}`, `+${percent(limit - 1)}`],
    words: `at a vertex: mean change ${percent(mean)}, largest ${percent(most)}`,
  };
}

function wrong({ limit, mean, most, size }) {
  return {
    title: "Distance to the truth",
    ends: ["0", `${number(limit)}+`],
    words: `mean ${number(mean)} (${percent(mean / size)} of the size), largest ${number(most)}`,
  };
}

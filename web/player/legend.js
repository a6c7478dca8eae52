// The legend of a coloured result: the colour scale, and the statistics of the current frame.
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
    this.statistics = this.box.appendChild(make("span", "legend-words"));
    stage.element.append(this.box);
    stage.addEventListener("time", () => this.show());
  }

  show() {
    const { measure } = this.stage;
    this.box.hidden = !measure;
    if (!measure) return;
    const { title, ends, statistics } = measure.what === "stretch" ? stretchLegend(measure) : errorLegend(measure);
    this.title.textContent = title;
    this.strip.style.background = measure.css;
    [this.low.textContent, this.high.textContent] = ends;
    this.statistics.textContent = statistics;
  }

  dispose() {
    this.box.remove();
  }
}

function stretchLegend({ limit, mean, largest }) {
  return {
    title: "Edge lengths, against the identity",
    ends: [`−${percent(1 - 1 / limit)}`, `+${percent(limit - 1)}`],
    statistics: `at a vertex: mean change ${percent(mean)}, largest ${percent(largest)}`,
  };
}

function errorLegend({ limit, mean, largest, size }) {
  return {
    title: "Distance to the truth",
    ends: ["0", `${number(limit)}+`],
    statistics: `mean ${number(mean)} (${percent(mean / size)} of the size), largest ${number(largest)}`,
  };
}

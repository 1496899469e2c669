// How far the rankings are, and how the person gets on.

import { get } from "./api.js";
import { session } from "./session.js";
import { settings } from "./settings.js";

const byId = (id) => document.getElementById(id);

// What goes on meanwhile, by stage of the run.
const MEANWHILE = {
  align: "Your rankings are being learnt from.",
  train: "The robot learns.",
  evaluate: "The robot shows what it has learnt.",
  over: "The run is over.",
};

export const standing = {
  enough: false, // as many as were wanted have been given
  wanted: 0,
  meanwhile: "",

  // Returns whether more is wanted than when it was shown last: of what the robot does now.
  show({ given, wanted, needed }) {
    const isMore = needed > 0 && this.wanted > 0 && wanted > this.wanted;
    this.wanted = wanted;
    this.enough = wanted > 0 && needed === 0;
    byId("standing").hidden = false;
    byId("standing-count").textContent = needed ? `${given} of ${wanted}` : `${given} ranked`;
    byId("standing-more").textContent = needed ? `· ${needed} still needed` : this.thanks();
    byId("standing-bar").hidden = !wanted;
    if (wanted) byId("standing-bar").value = Math.min(1, given / wanted);
    return isMore;
  },

  thanks() {
    return this.enough ? `· Enough for now, thank you. ${this.meanwhile}`.trimEnd() : "";
  },

  // Asks: at the start, then now and then, for it costs the server more than an answer does.
  // Returns what show() does.
  async refresh() {
    try {
      const progress = await progressOf(settings.name);
      this.meanwhile = MEANWHILE[progress.stage] ?? "";
      const isMore = this.show(progress.standing);
      byId("question").textContent = progress.question;
      const own = progress.annotators.find(({ annotator }) => annotator === settings.name);
      const answers = own ? own.ranked + own.undecided + own.skipped : 0;
      byId("undo").disabled = !answers && !session.lastAnswer(settings.name);
      byId("consistency").textContent =
        own?.consistency == null
          ? ""
          : `Own consistency ${Math.round(own.consistency * 100)} % (${own.consistency_pairs} pairs asked again)`;
      return isMore;
    } catch (error) {
      // The next answer tells, if one is to come.
      if (error.status === 0) this.meanwhile = "The server is gone; perhaps the run is over.";
      if (error.status === 0 && this.enough) byId("standing-more").textContent = this.thanks();
      return false;
    }
  },
};

export function progressOf(name) {
  return get(`/api/progress?annotator=${encodeURIComponent(name)}`);
}

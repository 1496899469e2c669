// How far the rankings are, and how the person gets on.

import { get } from "./api.js";
import { session } from "./session.js";
import { settings } from "./settings.js";

const byId = (id) => document.getElementById(id);

export const standing = {
  enough: false, // as many as were wanted have been given

  show({ given, wanted, needed }) {
    this.enough = wanted > 0 && needed === 0;
    byId("standing").hidden = false;
    byId("standing-count").textContent = needed ? `${given} of ${wanted}` : `${given} ranked`;
    byId("standing-more").textContent = needed ? `· ${needed} still needed` : wanted ? "· Enough for now, thank you." : "";
    byId("standing-bar").hidden = !wanted;
    if (wanted) byId("standing-bar").value = Math.min(1, given / wanted);
  },

  // Asks: at the start, then now and then, for it costs the server more than an answer does.
  async refresh() {
    try {
      const progress = await progressOf(settings.name);
      this.show(progress.standing);
      byId("question").textContent = progress.question;
      const own = progress.annotators.find(({ annotator }) => annotator === settings.name);
      const answers = own ? own.ranked + own.undecided + own.skipped : 0;
      byId("undo").disabled = !answers && !session.lastAnswer(settings.name);
      byId("consistency").textContent =
        own?.consistency == null
          ? ""
          : `Own consistency ${Math.round(own.consistency * 100)} % (${own.consistency_pairs} pairs asked again)`;
    } catch {
      // the next answer tells
    }
  },
};

export function progressOf(name) {
  return get(`/api/progress?annotator=${encodeURIComponent(name)}`);
}

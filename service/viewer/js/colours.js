// One colour per mode, by rank: the same in outlines, cloud, list and plots.
export const MODES = ["#4da3ff", "#ffb454", "#c792ea", "#5ad4a6", "#ff7a90", "#e6dc6a", "#b98b6b", "#9fb0c3"];
export const modeColour = (rank) => MODES[Math.min(rank, MODES.length - 1)];

export const STATUS = {
  tracking: { colour: "#5ad4a6", says: "Tracking" },
  acquiring: { colour: "#ffb454", says: "Acquiring" },
  ambiguous: { colour: "#e6dc6a", says: "Ambiguous" },
  no_fit: { colour: "#c792ea", says: "Does not fit" },
  lost: { colour: "#ff7a90", says: "Lost" },
  no_target: { colour: "#7c8b9d", says: "No target" },
};

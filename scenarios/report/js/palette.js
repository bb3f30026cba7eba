/* Colours of estimators, the same in every chart; after Paul Tol's and Okabe & Ito's colour-blind safe sets. */
export const COLOURS = ["#8a8f98", "#0072b2", "#56b4e9", "#e69f00", "#009e73", "#7b5cd6", "#b294e8", "#cc79a7", "#a6761d", "#c9a27a", "#12aebd", "#7f9f2f", "#ff8a75", "#d62728"];
export const DASHES = [[], [7, 3], [2, 2]]; // the palette a second and a third time over

/* The leaderboard: tables that a heading sorts. */
import { makeSortable } from "./tables.js";
import { themed } from "./theme.js";

themed(() => {});
makeSortable();

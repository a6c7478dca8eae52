// What the studio uses of the player, whose bundle the page loads before its own, so that three.js is sent once.
export const { Controls, Stage, make } = globalThis.mimeshPlayer;

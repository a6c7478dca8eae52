// The parts of the player that the studio uses. The page loads the player's bundle first, so that three.js is sent once.
export const { Controls, Stage, make } = globalThis.mimeshPlayer;

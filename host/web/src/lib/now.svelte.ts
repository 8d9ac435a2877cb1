/// The time of this page, for sentences that say how long ago something was: ms, once a second.
export const clockNow = $state({ ms: Date.now() });

setInterval(() => (clockNow.ms = Date.now()), 1000);

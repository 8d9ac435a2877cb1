//! Plays the situations: brings each about and compares what every kind of command comes to.
//!
//! Invariant: a failure names the situation, the kind and how it was asked; nothing else than [`fate`] says
//! what is right.

use serde_json::json;
use trocar::model::{ConnectOptions, State};
use trocar_sdk::Outcome;

use super::super::waiting::{self, While};
use super::super::{Answer, Call, Function, Lab, Reach, Way};
use super::{Fate, Kind, Mode, Situation, fate};
use crate::eventually;

/// Depth of the queue that is to be filled.
const DEPTH: u32 = 4;
/// Within every kind's limits, and outside of those that have some.
const FITS: f64 = 3.0;
const OUTSIDE: f64 = 100.5;
/// Deadline of a call that is to miss it, ms.
const SOON_MS: u64 = 20;
/// Deadline of a call that is to be begun first, ms: long enough for a busy machine, and waited for in full.
const BEGUN_MS: u64 = 500;

pub mod cases {
    //! One case for each situation.

    use super::super::super::Way;
    use super::{Situation, play};

    macro_rules! cases {
        ($($name:ident: $situation:ident,)+) => {
            $(pub fn $name(way: &Way) {
                play(way, Situation::$situation);
            })+
        };
    }

    cases! {
        of_a_command: ACommand,
        of_a_step: AStep,
        of_a_thread_of_its_own: AThreadOfItsOwn,
        without_a_connection: NoConnection,
        of_a_server_that_is_not_active: NotActive,
        of_arguments_outside_their_limits: OutsideItsLimits,
        of_a_server_that_refuses: Refusing,
        of_a_busy_server: ABusyServer,
        of_a_busy_server_in_a_command: ABusyServerFromACommand,
        of_a_full_queue: AFullQueue,
        of_what_was_begun_and_does_not_come_back: BegunAndHeld,
        of_what_was_begun_when_the_connection_is_cut: BegunAndCut,
        of_what_was_begun_when_the_server_is_stopped: BegunAndStopped,
        of_what_was_begun_when_the_server_is_removed: BegunAndRemoved,
        of_what_was_begun_and_panics: BegunAndPanics,
        when_the_connection_is_cut: CutWhileWaiting,
        when_the_server_is_stopped: StoppedWhileWaiting,
        when_the_server_is_removed: RemovedWhileWaiting,
        when_the_server_fails: FailedWhileWaiting,
        of_commands_that_are_withdrawn: Withdrawn,
    }
}

/// All ways to ask that differ, one after the other; those that were wrong are told together.
fn play(way: &Way, situation: Situation) {
    let stage = Stage::new(way, situation);
    let mut wrong = Vec::new();
    for kind in Kind::ALL {
        for mode in Mode::ALL {
            let expected = fate(way.reach(), situation, kind, mode);
            let mut answer = stage.ask(kind, mode);
            if way.reach() == Reach::Machine && situation == Situation::ABusyServer {
                // Its caller's deadline and the word that it was recalled come at the same time.
                answer.may_still_run = u64::from(expected == Fate::StillRuns);
            }
            if !expected.is(&answer, 1) {
                wrong.push(format!("{kind:?}, {mode:?}: {expected:?} was expected, this came: {answer:?}"));
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "{situation:?}, {}, {:?}:\n{}",
        way.deployment.name(),
        way.languages,
        wrong.join("\n")
    );
}

/// Client and server, and what the situation wants of them.
struct Stage<'a> {
    way: &'a Way,
    situation: Situation,
    lab: Lab,
}

fn call(kind: Kind, mode: Mode, x: f64) -> Call {
    match mode {
        Mode::Send => Call::send(kind.function(), x),
        Mode::Call => Call::call(kind.function(), x).within_ms(20_000),
    }
}

/// The fate of commands that find room in a queue nobody looks into.
fn first_of(mode: Mode) -> Fate {
    match mode {
        Mode::Send => Fate::Queued,
        Mode::Call => Fate::TooLate,
    }
}

impl<'a> Stage<'a> {
    fn new(way: &'a Way, situation: Situation) -> Stage<'a> {
        let lab = match situation {
            Situation::NoConnection | Situation::NotActive | Situation::AFullQueue => Lab::pair(way),
            Situation::Withdrawn => Lab::pair_of(way, "Client", "Shelf", json!({ "slots": ["left"] })),
            _ => Lab::running(way),
        };
        match situation {
            Situation::NotActive => lab.connect("client/peer", "server/ctl"),
            Situation::AFullQueue => {
                let options = ConnectOptions { mailbox: Some(DEPTH as usize), ..ConnectOptions::default() };
                lab.connect_with("client/peer", "server/ctl", options);
                lab.start("server");
            }
            Situation::Withdrawn => {
                lab.connect("client/peer", "server/slot_left");
                lab.start("server");
            }
            Situation::Refusing => mood(&lab, "refuse"),
            Situation::BegunAndHeld
            | Situation::BegunAndCut
            | Situation::BegunAndStopped
            | Situation::BegunAndRemoved => mood(&lab, "hold"),
            Situation::BegunAndPanics => mood(&lab, "panic"),
            _ => {}
        }
        if matches!(
            situation,
            Situation::NoConnection | Situation::NotActive | Situation::AFullQueue | Situation::Withdrawn
        ) {
            lab.start("client");
        }
        Stage { way, situation, lab }
    }

    fn reach(&self) -> Reach {
        self.way.reach()
    }

    /// From the client's own thread where that may run it, else from a thread that may wait.
    fn plainly(&self, call: Call) -> Answer {
        let may = !self.reach().queues() || !call.wait;
        self.lab.perform(if may { call } else { call.from_threads(1) })
    }

    fn ask(&self, kind: Kind, mode: Mode) -> Answer {
        let lab = &self.lab;
        let asked = call(kind, mode, FITS);
        match self.situation {
            Situation::ACommand => lab.perform(asked),
            Situation::AStep => lab.perform_in_step(asked),
            Situation::NoConnection | Situation::NotActive | Situation::Refusing => self.plainly(asked),
            Situation::OutsideItsLimits => self.plainly(call(kind, mode, OUTSIDE)),
            Situation::AThreadOfItsOwn => lab.perform(
                if self.reach() == Reach::Thread { asked.within_ms(SOON_MS) } else { asked }.from_threads(1),
            ),
            Situation::ABusyServer => self.busy(|| lab.perform(asked.within_ms(SOON_MS).from_threads(1))),
            Situation::ABusyServerFromACommand => self.busy(|| lab.perform(asked)),
            Situation::AFullQueue => self.full(kind, mode),
            Situation::BegunAndHeld => self.held(asked),
            Situation::BegunAndCut => self.begun(asked, While::Cut),
            Situation::BegunAndStopped => self.begun(asked, While::Stopped),
            Situation::BegunAndRemoved => self.begun(asked, While::Removed),
            Situation::BegunAndPanics => self.panics(asked),
            Situation::CutWhileWaiting
            | Situation::StoppedWhileWaiting
            | Situation::RemovedWhileWaiting
            | Situation::FailedWhileWaiting => self.ended(kind, mode),
            Situation::Withdrawn => self.withdrawn(kind, mode),
        }
    }

    /// While somebody else is inside the server; where client and server share a thread, whoever calls from
    /// another one finds it busy all the time.
    fn busy(&self, ask: impl FnOnce() -> Answer) -> Answer {
        if self.reach() == Reach::Thread { ask() } else { self.lab.occupied(ask) }
    }

    /// Fills the queue by the same command and answers what the last one came to.
    fn full(&self, kind: Kind, mode: Mode) -> Answer {
        let asked = call(kind, mode, FITS).within_ms(SOON_MS);
        let from = u32::from(self.reach() == Reach::Thread || mode == Mode::Call);
        let lab = &self.lab;
        // Whoever is answered second was taken after what the kind before had left in the queue.
        for _ in 0..2 {
            lab.invoke("server/ctl/poke", None, false).expect("the server is there");
        }
        if self.reach().queues() {
            // The thread that runs the queue may not have come to it yet, as in another process: a call
            // behind all of it is answered when it has.
            eventually("the queue is empty", || {
                match lab.perform(call(Kind::Void, Mode::Call, FITS).from_threads(1)) {
                    answer if Fate::Executed.is(&answer, 1) => Ok(()),
                    answer => Err(format!("{answer:?}")),
                }
            });
        }
        if self.reach() == Reach::Machine {
            let ask = || lab.perform(asked.times(2 * DEPTH + 1).from_threads(from));
            return self.full_at_both_ends(kind, mode, ask);
        }
        let mut all = self.busy(|| lab.perform(asked.times(DEPTH + 1).from_threads(from)));
        let first = match kind.reads() {
            true => fate(self.reach(), self.situation, kind, mode),
            false => first_of(mode),
        };
        all.take(first.outcome(), u64::from(DEPTH));
        all
    }

    /// The same where each machine has a queue: as many again are taken, as soon as those before are there.
    fn full_at_both_ends(&self, kind: Kind, mode: Mode, ask: impl FnOnce() -> Answer) -> Answer {
        let mut all = self.busy(ask);
        let (first, depth) = match kind.reads() {
            true => (fate(self.reach(), self.situation, kind, mode), 2 * DEPTH),
            false => (first_of(mode), DEPTH),
        };
        let taken = all.count(first.outcome());
        assert!(
            (u64::from(depth)..=u64::from(2 * DEPTH + 1)).contains(&taken),
            "{kind:?}, {mode:?}: {all:?}"
        );
        if kind.reads() {
            all.take(first.outcome(), taken - 1);
            return all;
        }
        all.take(first.outcome(), taken);
        all.take(Outcome::QueueFull, all.count(Outcome::QueueFull).saturating_sub(1));
        // Calls that are on their way may have begun.
        all.may_still_run = 0;
        all
    }

    fn held(&self, asked: Call) -> Answer {
        let lab = &self.lab;
        if asked.what.reads() {
            return self.plainly(asked);
        }
        lab.close_gate();
        let own = !self.reach().queues();
        let asked = if own || !asked.wait { asked } else { asked.within_ms(BEGUN_MS).from_threads(1) };
        let answer = std::thread::scope(|scope| {
            let answer = scope.spawn(|| lab.perform(asked));
            lab.await_waiting();
            if own {
                lab.open_gate();
            }
            answer.join().expect("the client performs")
        });
        lab.open_gate();
        // Nobody is inside any more when the gate is closed again.
        lab.invoke("server/ctl/poke", None, false).expect("the server is there again");
        answer
    }

    /// Something happens to the server while the command is inside it; then all is made as it was.
    fn begun(&self, asked: Call, what: While) -> Answer {
        let lab = &self.lab;
        if asked.what.reads() {
            return self.plainly(asked);
        }
        let ran = || lab.count("server", "pokes") + lab.count("server", "writes");
        let before = ran();
        let answer = waiting::begun(self.way, lab, asked, what);
        if what == While::Removed {
            lab.create(
                "server",
                "Server",
                lab.gated(json!({ "mood": "hold" })),
                self.way.deployment.server(),
            );
        } else {
            let counted = [Function::Poke, Function::Write].contains(&asked.what);
            eventually("what was begun has run, once", || match ran() - before {
                n if n == u64::from(counted) => Ok(()),
                n => Err(format!("{:?} ran {n} times", asked.what)),
            });
        }
        if what != While::Stopped {
            lab.connect("client/peer", "server/ctl");
        }
        if what != While::Cut {
            lab.start("server");
        }
        // Nobody is inside any more when the gate is closed again.
        lab.invoke("server/ctl/poke", None, false).expect("the server is there again");
        answer
    }

    fn panics(&self, asked: Call) -> Answer {
        let answer = self.plainly(asked);
        if !asked.what.reads() {
            self.lab.await_state("server", State::Fault);
            self.lab.reset("server");
            self.lab.start("server");
        }
        answer
    }

    /// Asks while the server is busy; what is called then waits, and something happens to the server.
    fn ended(&self, kind: Kind, mode: Mode) -> Answer {
        if kind.reads() || mode == Mode::Send {
            let lab = &self.lab;
            return self.busy(|| lab.perform(call(kind, mode, FITS).from_threads(1)));
        }
        let ends = match self.situation {
            Situation::CutWhileWaiting => While::Cut,
            Situation::StoppedWhileWaiting => While::Stopped,
            Situation::RemovedWhileWaiting => While::Removed,
            _ => While::Failed,
        };
        let lab = Lab::running(self.way);
        waiting::ended(self.way, &lab, call(kind, mode, FITS), ends)
    }

    /// Asks while the server's configuration, which takes the command away, is under way, or right after it.
    fn withdrawn(&self, kind: Kind, mode: Mode) -> Answer {
        let lab = &self.lab;
        let waits = !kind.reads() && self.reach() != Reach::Thread;
        if waits {
            waiting::through_configure(self.way, lab, call(kind, mode, FITS))
        } else {
            eventually("somebody asks between the change of the ports and the cut", || {
                let mut answer = if kind.reads() && self.reach() != Reach::Thread {
                    let asked = call(kind, mode, FITS);
                    let by_threads = u32::from(kind.is_asked_for(self.reach()));
                    waiting::beside_configure(lab, asked.from_threads(by_threads))
                } else {
                    waiting::after_configure(lab, call(kind, mode, FITS))
                };
                // Before the change, and after the cut.
                answer.outcomes.retain(|(o, _)| ![Outcome::Executed, Outcome::Unbound].contains(o));
                if kind.is_asked_for(self.reach()) {
                    // Asked before the cut, and not answered before it.
                    answer.outcomes.retain(|(o, _)| *o != Outcome::PeerLost);
                }
                match answer.outcomes.first().copied() {
                    Some((outcome, _)) => {
                        answer.outcomes[0] = (outcome, 1);
                        Ok(answer)
                    }
                    None => Err("nobody did"),
                }
            })
        }
    }
}

fn mood(lab: &Lab, mood: &str) {
    lab.configure("server", json!({ "mood": mood })).expect("mood is live");
}

//! A GCM that another one takes the place of, while changes are asked for.
//!
//! Invariant: each change is asked for until it is answered, by one id as long as no answer says that it was
//! not carried out; so the time without changes is the time between two answers.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use crate::book::{Book, Timed};
use crate::clock::{Witness, eventually, now_ns, pause_ms};
use crate::invariants::{Desired, agree};
use crate::linear::There;
use crate::program::Program;
use crate::rpc::Rpc;
use crate::run::{Row, Run, When};
use crate::site::Site;

use super::deciding::Flow;
use super::racing::{Heard, any, ask, listed};

pub(crate) const ROWS: &[Row] =
    &[Row { name: "takeover", fault: "another GCM takes over", when: When::Gate, run: takeover }];

/// Longest time without changes (managers.md §7), ms.
const REFUSED_FOR: f64 = 300.0;

/// Somebody who asks for one change after the other.
#[derive(Default)]
struct Asker {
    there: There,
    /// Times of the answers, ns.
    answered: Vec<u64>,
}

impl Asker {
    fn ask_on(&mut self, rpc: &Rpc, ends: &AtomicBool, seed: u64) -> Result<(), String> {
        let mut random = fastrand::Rng::with_seed(seed);
        for n in 0.. {
            if ends.load(Ordering::Relaxed) {
                break;
            }
            let what = any(&mut random);
            let (expected, after) = self.there.asked(what);
            let mut again = 0;
            let said = eventually("an answer", || {
                // A refusal is remembered by its id, a lost answer is asked for by it.
                match ask(rpc, 0, what, &format!("{seed}-{n}-{again}")) {
                    Heard::Said(said, _) => Ok(said),
                    Heard::Lost => Err("lost".into()),
                    Heard::Refused(why) => {
                        again += 1;
                        Err(why)
                    }
                }
            })?;
            if said != expected {
                return Err(format!("{what:?} of {:?} was answered with {said:?}", self.there));
            }
            self.there = after.unwrap_or_else(|| self.there.clone());
            self.answered.push(now_ns());
        }
        Ok(())
    }

    /// The longest time between two answers, from that time on, ns.
    fn longest(&self, from: u64) -> (u64, u64) {
        let pairs = self.answered.windows(2).map(|pair| (pair[0], pair[1]));
        pairs.filter(|(_, to)| *to >= from).max_by_key(|(from, to)| to - from).unwrap_or_default()
    }
}

fn takeover(run: &Run, book: &mut Book) -> Result<(), String> {
    let mut random = run.random(book);
    let mut site = Site::new(&["fixture_torture"], &["a", "b"])?;
    let flow = Flow::start(&site, "a/untouched", "b/untouched")?;
    let (mut asker, witness) = (Asker::default(), Witness::start());
    let (mut took, mut went, rounds) = (Vec::<Timed>::new(), Ok(()), run.times(3, 100));
    for round in 0..rounds {
        let (ends, rpc, seed) = (AtomicBool::new(false), site.rpc.clone(), random.u64(..));
        let began = now_ns();
        witness.forget();
        let done = thread::scope(|scope| {
            let asking = scope.spawn(|| asker.ask_on(&rpc, &ends, seed));
            pause_ms(random.u64(50..150));
            let taken = taken_over(&mut site, round);
            pause_ms(100);
            ends.store(true, Ordering::Relaxed);
            let asked = asking.join().map_err(|_| "the one who asks panicked".to_owned()).flatten();
            taken.and(asked)
        });
        let (from, to) = asker.longest(began);
        took.push(witness.timed(from, to, 0.0));
        went = done.and_then(|()| settled(&site, &asker)).map_err(|why| format!("round {round}: {why}"));
        if went.is_err() {
            break;
        }
    }
    book.check(
        "each answer is as without a takeover, and all of it is there (G1, G3)",
        rounds as usize,
        went,
    );
    book.at_least("changes that were asked for", rounds as usize, asker.answered.len() as u64, 100);
    book.times("no change is made", &took, REFUSED_FOR);
    flow.tell(book, &site)?;
    let journal = site.journal()?;
    book.check("numbers, terms and revisions only grow (G2)", journal.records.len(), journal.grows());
    site.down(book)
}

/// Another one takes over; the one before ends in order.
fn taken_over(site: &mut Site, round: u64) -> Result<(), String> {
    let state = site.world.text("state/gcm");
    let args = ["gcm", "--takeover", "--state", &state].map(str::to_owned);
    let mut next = Program::begin(&site.world, &format!("takeover-{round}"), &args, false)?;
    next.await_address()?;
    if next.address != site.gcm.address {
        return Err(format!("it listens at {}, and not at {}", next.address, site.gcm.address));
    }
    let mut before = std::mem::replace(&mut site.gcm, next);
    let status = before.await_end()?;
    if status.success() { Ok(()) } else { Err(format!("the one before: {status}: {}", before.printed())) }
}

fn settled(site: &Site, asker: &Asker) -> Result<(), String> {
    site.await_all()?;
    let list = site.rpc.brief()?;
    if listed(0, &list) != asker.there {
        return Err(format!("{:?} is listed as {:?}", asker.there, listed(0, &list)));
    }
    agree(&site.rpc, &Desired::now(&site.rpc)?)
}

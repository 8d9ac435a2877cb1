//! One supervised process: spawned, watched, started again or given up.
//!
//! Invariant: the status is true at any time; a process that was asked to end is not started again.

use std::convert::Infallible;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use tokio::sync::{mpsc, watch};

use super::Exit;
use super::child::{Child, Program, Said};
use super::policy::{History, How, Verdict};
use super::status::{Board, Phase, Status};

/// Time for a child to end after it was asked to.
const PATIENCE: Duration = Duration::from_secs(12);
/// The same for a child that is put down because it is of no use.
const USELESS: Duration = Duration::from_secs(3);
/// Size at which a child's output becomes the old output, bytes; two are kept.
const OUTPUT: u64 = 8 << 20;
/// Time between two looks at that size.
const LOOK: Duration = Duration::from_secs(1);

/// Orders to a keeper.
pub(super) struct Orders {
    /// True: the process is to end, and not to be started again.
    pub(super) down: watch::Receiver<bool>,
    /// The incarnation of this number is of no use: why.
    pub(super) put_down: mpsc::UnboundedReceiver<(u32, String)>,
    /// The process is to be started again, with a clean record.
    pub(super) again: mpsc::UnboundedReceiver<()>,
}

/// Keeps a process until it is asked to end. Returns how it ended, if it ran when it was asked to.
pub(super) async fn keep(program: Program, board: Board, orders: Orders) -> Option<Exit> {
    let (history, listen) = (History::new(program.policy), program.listen.clone());
    let mut keeper = Keeper { program, board, orders, history, listen, restarts: 0 };
    loop {
        match keeper.run().await {
            Ran::Down(exit) => return Some(exit),
            Ran::Anew => {}
            Ran::Ended(exit, how, refused) => {
                let verdict = keeper.judge(&exit, how, &refused);
                if !keeper.waits(verdict).await {
                    return None;
                }
            }
        }
        keeper.restarts += 1;
    }
}

/// End of one incarnation.
enum Ran {
    /// The process ended by itself or was of no use, or could not be started; the reason is in its own words.
    Ended(Exit, How, Option<Value>),
    /// The process was ended to be started again.
    Anew,
    /// The process was asked to end.
    Down(Exit),
}

struct Keeper {
    program: Program,
    board: Board,
    orders: Orders,
    history: History,
    /// Address to listen on: of a process that stays, the one it had first.
    listen: String,
    restarts: u32,
}

impl Keeper {
    fn set(&self, change: &dyn Fn(&mut Status)) {
        self.board.change(&self.program.name, change);
    }

    /// Spawns the process and follows it to its end.
    async fn run(&mut self) -> Ran {
        let restarts = self.restarts;
        let mut child = match Child::spawn(&self.program, &self.listen) {
            Ok(child) => child,
            Err(e) => {
                self.set(&|s| s.restarts = restarts);
                return Ran::Ended(Exit::NotStarted(e.to_string()), How::Failed, None);
            }
        };
        let (pid, mut refused) = (child.pid, None);
        // In one step: nobody may take the end of the previous incarnation for an end of this one.
        self.set(&|s| (s.phase, s.pid, s.restarts) = (Phase::Starting, pid, restarts));
        let exit = tokio::select! {
            exit = live(&mut child, &self.program, &self.board, &mut self.listen, &mut refused) => exit,
            why = useless(&mut self.orders.put_down, pid) => child.end(USELESS, Some(why)).await,
            () = anew(&mut self.orders.again) => {
                let exit = child.end(PATIENCE, None).await;
                self.set(&|s| (s.phase, s.last_exit) = (Phase::Restarting, Some(exit.clone())));
                self.history = History::new(self.program.policy);
                return Ran::Anew;
            }
            () = asked(&mut self.orders.down) => {
                let exit = child.end(PATIENCE, None).await;
                self.set(&|s| (s.phase, s.last_exit) = (Phase::Ended, Some(exit.clone())));
                return Ran::Down(exit);
            }
        };
        let how = match (&exit, &refused) {
            (Exit::Code(0), _) if child.said_farewell() => How::AsAsked,
            (_, Some(_)) => How::Refused,
            _ => How::Failed,
        };
        Ran::Ended(exit, how, refused)
    }

    /// Decides what follows an end, and shows it.
    fn judge(&mut self, exit: &Exit, how: How, refused: &Option<Value>) -> Verdict {
        let verdict = self.history.ended(how, Instant::now());
        let phase = match verdict {
            Verdict::Restart { .. } => Phase::Restarting,
            Verdict::GiveUp => Phase::Failed,
            Verdict::Leave => Phase::Ended,
        };
        self.set(&|s| {
            s.phase = phase;
            s.last_exit = Some(exit.clone());
            s.refused.clone_from(refused);
        });
        verdict
    }

    /// Waits until the process is to be started again; false: it is to end instead.
    async fn waits(&mut self, verdict: Verdict) -> bool {
        let pause = async {
            match verdict {
                Verdict::Restart { after } => tokio::time::sleep(after).await,
                // Waits until the process is wanted back.
                Verdict::GiveUp | Verdict::Leave => std::future::pending().await,
            }
        };
        tokio::select! {
            () = pause => true,
            () = anew(&mut self.orders.again) => {
                self.set(&|s| s.phase = Phase::Restarting);
                self.history = History::new(self.program.policy);
                true
            }
            () = asked(&mut self.orders.down) => {
                self.set(&|s| s.phase = Phase::Ended);
                false
            }
        }
    }
}

/// Returns when the process is to end, or when nobody can ask for that any more.
async fn asked(down: &mut watch::Receiver<bool>) {
    let _ = down.wait_for(|down| *down).await;
}

/// Returns when the process is to be started again; two requests start it once.
async fn anew(again: &mut mpsc::UnboundedReceiver<()>) {
    if again.recv().await.is_none() {
        std::future::pending::<()>().await;
    }
    while again.try_recv().is_ok() {}
}

/// Returns when this incarnation is reported to be of no use; reports about others are forgotten.
async fn useless(put_down: &mut mpsc::UnboundedReceiver<(u32, String)>, pid: u32) -> String {
    loop {
        match put_down.recv().await {
            Some((of, why)) if of == pid => return why,
            Some(_) => {}
            None => std::future::pending().await,
        }
    }
}

/// Follows a child from its first message, which has a time limit, to its end.
async fn live(
    child: &mut Child,
    program: &Program,
    board: &Board,
    listen: &mut String,
    refused: &mut Option<Value>,
) -> Exit {
    let limit = program.policy.start_within();
    let start = async {
        match child.first_word().await {
            Some(Said::Listening(address)) => return Ok(address),
            Some(Said::Refused(why)) => *refused = Some(why),
            // The process says nothing a supervisor understands, and may still end for a reason.
            None => {}
        }
        Err(child.ended().await)
    };
    let address = match tokio::time::timeout(limit, start).await {
        Ok(Ok(address)) => address,
        Ok(Err(exit)) => return exit,
        Err(_) => {
            let why = format!("did not serve within {} s", limit.as_secs_f64());
            return child.end(USELESS, Some(why)).await;
        }
    };
    if program.stays {
        listen.clone_from(&address);
    }
    board.change(&program.name, &|s| {
        s.phase = Phase::Running;
        s.address = Some(address.clone());
        s.refused = None;
    });
    tokio::select! {
        exit = child.ended() => exit,
        never = keep_short(&program.output) => match never {},
    }
}

/// Puts the content of a file away when it is large. Its writers append, and go on at the new end.
pub async fn keep_short(output: &Path) -> Infallible {
    let mut look = tokio::time::interval(LOOK);
    loop {
        look.tick().await;
        if std::fs::metadata(output).is_ok_and(|m| m.len() > OUTPUT) {
            let path = output.to_owned();
            // Output that cannot be kept is lost; it matters more that the file does not grow.
            let _ = tokio::task::spawn_blocking(move || put_away(&path)).await;
        }
    }
}

fn put_away(output: &Path) {
    let _ = std::fs::copy(output, output.with_extension("old.log"));
    let _ = std::fs::File::options().write(true).open(output).and_then(|file| file.set_len(0));
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::io::Write;

    use super::*;

    #[test]
    fn what_is_printed_is_put_away_and_whoever_prints_goes_on() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("left.log");
        let mut printing = std::fs::File::options().create(true).append(true).open(&path).unwrap();
        printing.write_all(b"before\n").unwrap();
        put_away(&path);
        printing.write_all(b"after\n").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "after\n", "no hole at its beginning");
        assert_eq!(std::fs::read_to_string(dir.path().join("left.old.log")).unwrap(), "before\n");
    }
}

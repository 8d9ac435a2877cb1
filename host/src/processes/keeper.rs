//! One supervised process: spawned, watched, started again or given up.
//!
//! Invariant: the status is true at any time; a process that was asked to end is not started again.

use std::convert::Infallible;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use tokio::sync::{mpsc, watch};

use super::child::{Child, Program, Said};
use super::policy::{History, How, Verdict};
use super::{Exit, supervisor::Board};

/// Time for a child to end after it was asked to.
const PATIENCE: Duration = Duration::from_secs(12);
/// The same for a child that is put down because it is of no use.
const USELESS: Duration = Duration::from_secs(3);
/// Size at which a child's output becomes the old output, bytes; two are kept.
const OUTPUT: u64 = 8 << 20;
/// Time between two looks at that size.
const LOOK: Duration = Duration::from_secs(1);

/// Phase in the life of a supervised process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// Spawned, for the first time or again; it does not serve yet.
    #[default]
    Starting,
    /// The process serves, and is attached to its GCM if it has one.
    Running,
    /// The process failed and will be spawned again.
    Restarting,
    /// The process failed too often.
    Failed,
    /// The process ended and nobody wants it back.
    Ended,
}

/// Status of a supervised process.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    pub phase: Phase,
    /// Process id of the incarnation that runs, or ended last; 0 = none yet.
    pub pid: u32,
    /// Address where the process serves, or did.
    pub address: Option<String>,
    /// Number of times the process was spawned again.
    pub restarts: u32,
    pub last_exit: Option<Exit>,
    /// The reason why it did not start, in its own words.
    pub refused: Option<Value>,
}

impl Status {
    /// Returns how the process ended last, in words, with its own reason; "" when it never did.
    pub fn exit_text(&self) -> String {
        let said = self.refused.as_ref().and_then(|r| r["message"].as_str());
        match (&self.last_exit, said) {
            (None, _) => String::new(),
            (Some(exit), None) => exit.to_string(),
            (Some(exit), Some(said)) => format!("{exit}: {said}"),
        }
    }
}

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
    let Orders { mut down, mut put_down, mut again } = orders;
    let mut history = History::new(program.policy);
    let mut listen = program.listen.clone();
    let set = |change: &dyn Fn(&mut Status)| board.change(&program.name, change);
    let mut restarts = 0;
    loop {
        let mut refused = None;
        let (exit, farewell) = match Child::spawn(&program, &listen) {
            Err(e) => {
                set(&|s| s.restarts = restarts);
                (Exit::NotStarted(e.to_string()), false)
            }
            Ok(mut child) => {
                let pid = child.pid;
                // In one step: nobody may take the end of the previous incarnation for an end of this one.
                set(&|s| (s.phase, s.pid, s.restarts) = (Phase::Starting, pid, restarts));
                let exit = tokio::select! {
                    exit = live(&mut child, &program, &board, &mut listen, &mut refused) => exit,
                    why = useless(&mut put_down, pid) => child.end(USELESS, Some(why)).await,
                    () = anew(&mut again) => {
                        let exit = child.end(PATIENCE, None).await;
                        set(&|s| (s.phase, s.last_exit) = (Phase::Restarting, Some(exit.clone())));
                        history = History::new(program.policy);
                        restarts += 1;
                        continue;
                    }
                    () = asked(&mut down) => {
                        let exit = child.end(PATIENCE, None).await;
                        set(&|s| (s.phase, s.last_exit) = (Phase::Ended, Some(exit.clone())));
                        return Some(exit);
                    }
                };
                (exit, child.said_farewell())
            }
        };
        let how = match (&exit, &refused) {
            (Exit::Code(0), _) if farewell => How::AsAsked,
            (_, Some(_)) => How::Refused,
            _ => How::Failed,
        };
        let verdict = history.ended(how, Instant::now());
        let phase = match verdict {
            Verdict::Restart { .. } => Phase::Restarting,
            Verdict::GiveUp => Phase::Failed,
            Verdict::Leave => Phase::Ended,
        };
        set(&|s| {
            s.phase = phase;
            s.last_exit = Some(exit.clone());
            s.refused.clone_from(&refused);
        });
        let pause = async {
            match verdict {
                Verdict::Restart { after } => tokio::time::sleep(after).await,
                // Waits until the process is wanted back.
                Verdict::GiveUp | Verdict::Leave => std::future::pending().await,
            }
        };
        restarts += 1;
        tokio::select! {
            () = pause => {}
            () = anew(&mut again) => {
                set(&|s| s.phase = Phase::Restarting);
                history = History::new(program.policy);
            }
            () = asked(&mut down) => {
                set(&|s| s.phase = Phase::Ended);
                return None;
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

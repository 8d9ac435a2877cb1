//! One supervised process: spawned, watched, started again or given up.
//!
//! Invariant: its status says at any time what is true of it; asked to end, it is not started again.

use std::time::Instant;

use serde_json::Value;
use tokio::sync::watch;

use super::child::{Child, Program, Said};
use super::policy::{History, Verdict};
use super::{Exit, supervisor::Board};

/// Where a supervised process is in its life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// Spawned; it does not serve yet.
    #[default]
    Starting,
    /// It serves, and is attached to its GCM if it has one.
    Running,
    /// It failed and will be spawned again.
    Restarting,
    /// It failed too often.
    Failed,
    /// It ended and nobody wants it back.
    Ended,
}

/// How a supervised process stands.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    pub phase: Phase,
    /// Of the incarnation that runs, or ended last; 0 = none yet.
    pub pid: u32,
    /// Where it serves, or did.
    pub address: Option<String>,
    /// How often it was spawned again.
    pub restarts: u32,
    pub last_exit: Option<Exit>,
    /// Why it did not start, as it said itself.
    pub refused: Option<Value>,
}

impl Status {
    /// How it ended last, in words, with what it said about it; "" when it never did.
    pub fn exit_text(&self) -> String {
        let said = self.refused.as_ref().and_then(|r| r["message"].as_str());
        match (&self.last_exit, said) {
            (None, _) => String::new(),
            (Some(exit), None) => exit.to_string(),
            (Some(exit), Some(said)) => format!("{exit}: {said}"),
        }
    }
}

/// Keeps it until it is asked to end, or has been given up.
pub(super) async fn keep(program: Program, board: Board, mut down: watch::Receiver<bool>) {
    let mut history = History::new(program.policy);
    let mut listen = program.listen.clone();
    let set = |change: &dyn Fn(&mut Status)| board.change(&program.name, change);
    loop {
        let mut refused = None;
        let exit = match Child::spawn(&program, &listen) {
            Err(e) => Exit::NotStarted(format!("{}: {e}", program.file.display())),
            Ok(mut child) => {
                let pid = child.pid;
                set(&|s| s.pid = pid);
                tokio::select! {
                    exit = live(&mut child, &program, &board, &mut listen, &mut refused) => exit,
                    () = asked(&mut down) => {
                        let exit = child.end().await;
                        return set(&|s| {
                            (s.phase, s.last_exit) = (Phase::Ended, Some(exit.clone()));
                        });
                    }
                }
            }
        };
        let verdict = history.ended(&exit, Instant::now());
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
        let Verdict::Restart { after } = verdict else { return };
        tokio::select! {
            () = tokio::time::sleep(after) => {}
            () = asked(&mut down) => return set(&|s| s.phase = Phase::Ended),
        }
        set(&|s| s.restarts += 1);
    }
}

/// Ends when it is to end, or when nobody can ask for that any more.
async fn asked(down: &mut watch::Receiver<bool>) {
    let _ = down.wait_for(|down| *down).await;
}

/// From its first word to its end.
async fn live(
    child: &mut Child,
    program: &Program,
    board: &Board,
    listen: &mut String,
    refused: &mut Option<Value>,
) -> Exit {
    match child.first_word().await {
        Some(Said::Listening(address)) => {
            if program.stays {
                listen.clone_from(&address);
            }
            board.change(&program.name, &|s| {
                s.phase = Phase::Running;
                s.address = Some(address.clone());
                s.refused = None;
            });
        }
        Some(Said::Refused(why)) => *refused = Some(why),
        // It says nothing a supervisor understands, and may still end for a reason.
        None => {}
    }
    child.ended().await
}

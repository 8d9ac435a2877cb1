//! A `trocar` process: host, gcm or up, its output in files.
//!
//! Invariant: it is signalled by the number of a child that was not yet waited for, so the number is nobody
//! else's; when dropped it is killed and waited for.

use std::fs::{self, File};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};

use rustix::process::{Pid, Signal, kill_process};

use crate::clock::eventually;
use crate::files;
use crate::world::World;

pub(crate) struct Program {
    pub(crate) name: String,
    child: Child,
    /// What it is tied to: it ends in order when this is dropped.
    tie: Option<ChildStdin>,
    out: PathBuf,
    err: PathBuf,
    pub(crate) address: String,
}

impl Program {
    /// `trocar host` with the world's plugins; without a GCM named it has its own.
    pub(crate) fn host(world: &World, name: &str, gcm: Option<&str>) -> Result<Program, String> {
        Program::host_as(world, name, name, gcm)
    }

    /// The same with a state directory of another name.
    pub(crate) fn host_as(
        world: &World,
        name: &str,
        state: &str,
        gcm: Option<&str>,
    ) -> Result<Program, String> {
        let mut program = Program::begin(world, state, &host_args(world, name, state, gcm), false)?;
        program.await_address()?;
        Ok(program)
    }

    pub(crate) fn gcm(world: &World) -> Result<Program, String> {
        Program::gcm_at(world, "127.0.0.1:0")
    }

    pub(crate) fn gcm_at(world: &World, address: &str) -> Result<Program, String> {
        let state = world.text("state/gcm");
        let args = ["gcm", "--listen", address, "--state", &state].map(str::to_owned);
        let mut program = Program::begin(world, "gcm", &args, false)?;
        program.await_address()?;
        Ok(program)
    }

    /// `trocar up` of a system file; everything is up when this answers.
    pub(crate) fn up(world: &World, system: &str) -> Result<Program, String> {
        let file = world.write("system.json", system)?;
        let file = file.to_string_lossy();
        let args = ["up", &*file, "--listen", "127.0.0.1:0", "--json"].map(str::to_owned);
        let mut program = Program::begin(world, "up", &args, false)?;
        program.await_address()?;
        Ok(program)
    }

    /// Any command; does not wait for it. `tied`: a pipe is its standard input.
    pub(crate) fn begin(world: &World, name: &str, args: &[String], tied: bool) -> Result<Program, String> {
        let (out, err) = (world.path(&format!("{name}.out")), world.path(&format!("{name}.err")));
        let file = |path: &PathBuf| File::create(path).map_err(|e| format!("{}: {e}", path.display()));
        let mut child = Command::new(files::built("trocar")?)
            .args(args)
            .env_remove("TROCAR_GCM")
            .env("XDG_STATE_HOME", world.path("xdg-state"))
            .current_dir(world.root())
            .stdin(if tied { Stdio::piped() } else { Stdio::null() })
            .stdout(file(&out)?)
            .stderr(file(&err)?)
            .spawn()
            .map_err(|e| format!("trocar cannot be started: {e}"))?;
        let tie = child.stdin.take();
        Ok(Program { name: name.to_owned(), child, tie, out, err, address: String::new() })
    }

    /// Waits until it says where it listens.
    pub(crate) fn await_address(&mut self) -> Result<(), String> {
        let what = format!("{} prints the address it listens on", self.name);
        self.address = eventually(&what, || {
            if let Ok(Some(status)) = self.child.try_wait() {
                return Ok(Err(format!("{} ended at once with {status}:\n{}", self.name, self.printed())));
            }
            address_in(&self.printed()).map(Ok).ok_or_else(|| self.printed())
        })??;
        Ok(())
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    /// All it has printed so far, both streams.
    pub(crate) fn printed(&self) -> String {
        let read = |path: &PathBuf| fs::read_to_string(path).unwrap_or_default();
        format!("{}{}", read(&self.out), read(&self.err))
    }

    /// How it ended, if it has.
    pub(crate) fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    pub(crate) fn signal(&mut self, signal: Signal) -> Result<(), String> {
        match self.ended() {
            Some(status) => Err(format!("{} has ended already: {status}", self.name)),
            None => signal_to(self.pid(), signal),
        }
    }

    /// What `kill -9` does; waited for.
    pub(crate) fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Lets go of the tie.
    pub(crate) fn untie(&mut self) {
        self.tie = None;
    }

    /// Waits for its end.
    pub(crate) fn await_end(&mut self) -> Result<ExitStatus, String> {
        let what = format!("{} ends", self.name);
        eventually(&what, || self.ended().ok_or_else(|| "it runs".to_owned()))
    }

    /// Ends it in order.
    pub(crate) fn terminate(&mut self) -> Result<(), String> {
        self.signal(Signal::TERM)?;
        match self.await_end()? {
            status if status.success() || status.code() == Some(143) => Ok(()),
            status => Err(format!("{} ended with {status}:\n{}", self.name, self.printed())),
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // A stopped one would not end by itself.
        let _ = self.signal(Signal::CONT);
        self.kill();
    }
}

/// The arguments of `trocar host` with the world's plugins.
pub(crate) fn host_args(world: &World, name: &str, state: &str, gcm: Option<&str>) -> Vec<String> {
    let (plugins, state) = (world.text("plugins"), world.text(&format!("state/{state}")));
    let args = ["host", "--name", name, "--listen", "127.0.0.1:0", "--plugins", &plugins, "--state", &state];
    let mut args = args.map(str::to_owned).to_vec();
    args.extend(gcm.iter().flat_map(|gcm| ["--gcm".to_owned(), (*gcm).to_owned()]));
    args
}

/// Signals a process by number. The caller knows that it is the one it means.
pub(crate) fn signal_to(pid: u32, signal: Signal) -> Result<(), String> {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw).ok_or(format!("{pid} is no process"))?;
    kill_process(pid, signal).map_err(|e| format!("{signal:?} to {pid:?}: {e}"))
}

/// The first `127.0.0.1:PORT` in a text whose line is complete.
fn address_in(text: &str) -> Option<String> {
    let complete = &text[..text.rfind('\n')?];
    complete.match_indices("127.0.0.1:").find_map(|(at, host)| {
        let digits: String = complete[at + host.len()..].chars().take_while(char::is_ascii_digit).collect();
        (!matches!(digits.as_str(), "" | "0")).then(|| format!("{host}{digits}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_address_is_found_in_a_complete_line_only() {
        assert_eq!(address_in("listens on 127.0.0.1:40"), None);
        assert_eq!(address_in("asked for 127.0.0.1:0, got 127.0.0.1:41\n").as_deref(), Some("127.0.0.1:41"));
    }
}

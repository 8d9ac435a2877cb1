//! A built `trocar` process that serves: host, gcm, run or demo.
//!
//! Invariant: it listens on a port the kernel chose, it is killed by its handle when dropped, and what it
//! printed is shown when its test fails.

use std::ffi::OsString;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};

use crate::{Built, Grpcurl, World, eventually};

/// A running child, its output in two files.
pub struct HostProcess {
    child: Child,
    name: String,
    stdout: PathBuf,
    stderr: PathBuf,
    address: String,
}

impl HostProcess {
    /// `trocar host` with an embedded GCM, the world's plugin and state directories.
    #[must_use]
    pub fn start(world: &World) -> Self {
        Self::start_with(world, "host", &[])
    }

    /// The same with more arguments, and a name of its own for process and state directory.
    #[must_use]
    pub fn start_with(world: &World, name: &str, more: &[&str]) -> Self {
        Self::start_prepared(world, name, more, |_| ())
    }

    /// The same, its command prepared: limits, rights.
    #[must_use]
    pub fn start_prepared(
        world: &World,
        name: &str,
        more: &[&str],
        prepare: impl FnOnce(&mut Command),
    ) -> Self {
        let mut args: Vec<OsString> =
            ["host", "--name", name, "--listen", "127.0.0.1:0", "--plugins"].map(OsString::from).to_vec();
        args.push(world.plugins().into());
        args.push("--state".into());
        args.push(world.state().join(name).into());
        args.extend(more.iter().map(OsString::from));
        Self::spawn_prepared(world, name, &args, prepare)
    }

    /// `trocar gcm` alone.
    #[must_use]
    pub fn start_gcm(world: &World) -> Self {
        let mut args: Vec<OsString> =
            ["gcm", "--listen", "127.0.0.1:0", "--state"].map(OsString::from).to_vec();
        args.push(world.state().join("gcm").into());
        Self::spawn(world, "gcm", &args)
    }

    /// Any serving subcommand; waits for the address it prints.
    #[must_use]
    pub fn spawn(world: &World, name: &str, args: &[OsString]) -> Self {
        Self::spawn_prepared(world, name, args, |_| ())
    }

    fn spawn_prepared(
        world: &World,
        name: &str,
        args: &[OsString],
        prepare: impl FnOnce(&mut Command),
    ) -> Self {
        let (stdout, stderr) = (world.path(&format!("{name}.out")), world.path(&format!("{name}.err")));
        let file = |path: &Path| File::create(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let mut command = Command::new(Built::trocar());
        command
            .args(args)
            .env_remove("TROCAR_GCM")
            .env("XDG_STATE_HOME", world.path("xdg-state"))
            .current_dir(world.path(""))
            .stdin(Stdio::null())
            .stdout(file(&stdout))
            .stderr(file(&stderr));
        prepare(&mut command);
        let child = command.spawn().unwrap_or_else(|e| panic!("cannot start trocar: {e}"));
        let mut host = Self { child, name: name.to_owned(), stdout, stderr, address: String::new() };
        host.address = eventually(&format!("{name} prints the address it listens on"), || {
            if let Ok(Some(status)) = host.child.try_wait() {
                panic!("{name} ended at once with {status}:\n{}", host.printed());
            }
            address_in(&host.printed()).ok_or_else(|| host.printed())
        });
        host
    }

    /// Where it listens, `127.0.0.1:PORT`.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The name it was started by here.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    #[must_use]
    pub fn grpcurl(&self) -> Grpcurl {
        Grpcurl::new(&self.address)
    }

    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// All it has printed so far, both streams.
    #[must_use]
    pub fn printed(&self) -> String {
        let read = |path: &Path| fs::read_to_string(path).unwrap_or_default();
        format!("{}{}", read(&self.stdout), read(&self.stderr))
    }

    #[must_use]
    pub fn is_alive(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// What `kill -9` does.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Sends SIGINT, as Ctrl-C does, and waits for its end.
    pub fn interrupt(&mut self) -> ExitStatus {
        self.signal("-INT")
    }

    /// Sends SIGTERM and waits for its end.
    pub fn terminate(&mut self) -> ExitStatus {
        self.signal("-TERM")
    }

    fn signal(&mut self, signal: &str) -> ExitStatus {
        let sent = Command::new("kill").arg(signal).arg(self.child.id().to_string()).status();
        assert!(sent.is_ok_and(|s| s.success()), "kill {signal} {} did not work", self.child.id());
        eventually(&format!("{} ends after {signal}", self.name), || match self.child.try_wait() {
            Ok(Some(status)) => Ok(status),
            other => Err(format!("{other:?}; it printed:\n{}", self.printed())),
        })
    }
}

impl Drop for HostProcess {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("---- {} ({}) printed:\n{}----", self.name, self.address, self.printed());
        }
        self.kill();
    }
}

/// The first `127.0.0.1:PORT` in a text whose line is complete.
fn address_in(text: &str) -> Option<String> {
    let complete = &text[..text.rfind('\n')?];
    let at = complete.find("127.0.0.1:")?;
    let tail = &complete[at..];
    let end = tail["127.0.0.1:".len()..]
        .find(|c: char| !c.is_ascii_digit())
        .map_or(tail.len(), |n| n + "127.0.0.1:".len());
    (!tail[..end].ends_with(':') && !tail[..end].ends_with(":0")).then(|| tail[..end].to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_address_is_found_in_a_complete_line_only() {
        assert_eq!(address_in("host listens on 127.0.0.1:40"), None);
        assert_eq!(address_in("host listens on 127.0.0.1:4077, ok\n").as_deref(), Some("127.0.0.1:4077"));
        assert_eq!(address_in("asked for 127.0.0.1:0\n"), None);
    }
}

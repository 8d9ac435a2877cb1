//! The demo at a terminal.
//!
//! Promise: what to try stays in view, nothing is drawn beyond the edge, and what was reached stays
//! afterwards.

use std::ffi::CString;
use std::fs::File;
use std::io::Read;
use std::os::fd::{AsFd, OwnedFd};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use rustix::fs::{Mode, OFlags};
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};
use trocar_tests::{Built, World, eventually};

use crate::realtime::rights::limit;

/// A terminal of so many rows and columns, and a program at it.
struct Terminal {
    child: Child,
    shown: Arc<Mutex<String>>,
    reading: Option<JoinHandle<()>>,
}

impl Drop for Terminal {
    /// A test that fails leaves nothing running.
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Terminal {
    fn run(
        world: &World,
        args: &[&str],
        [rows, columns]: [u16; 2],
        prepare: impl FnOnce(&mut Command),
    ) -> Terminal {
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&ours).unwrap();
        unlockpt(&ours).unwrap();
        let name: CString = ptsname(&ours, Vec::new()).unwrap();
        let its = rustix::fs::open(name, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
        tcsetwinsize(&ours, Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
        let end = |fd: &OwnedFd| Stdio::from(fd.as_fd().try_clone_to_owned().unwrap());
        let mut command = Command::new(Built::trocar());
        command.args(args).current_dir(world.path("")).stdin(end(&its)).stdout(end(&its)).stderr(end(&its));
        command.env("XDG_STATE_HOME", world.path("xdg-state")).env_remove("TROCAR_GCM").env("TERM", "xterm");
        prepare(&mut command);
        let child = command.spawn().unwrap();
        let shown = Arc::new(Mutex::new(String::new()));
        let into = shown.clone();
        let reading = thread::spawn(move || {
            let (mut from, mut piece) = (File::from(ours), [0; 4096]);
            // It fails when nobody holds the other end any more.
            while let Ok(read @ 1..) = from.read(&mut piece) {
                let text = String::from_utf8_lossy(&piece[..read]).into_owned();
                into.lock().unwrap_or_else(PoisonError::into_inner).push_str(&text);
            }
        });
        Terminal { child, shown, reading: Some(reading) }
    }

    /// All that was written so far, escapes included.
    fn written(&self) -> String {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Ctrl-C, and its end; all that was written.
    fn interrupted(mut self) -> String {
        let pid = Pid::from_child(&self.child);
        kill_process(pid, Signal::INT).unwrap();
        assert!(self.child.wait().unwrap().success());
        self.reading.take().unwrap().join().unwrap();
        self.written()
    }
}

/// The last frame that was drawn whole, without colours.
fn last_drawn(written: &str) -> Vec<String> {
    let whole = written.rsplit_once("\x1b[J").map_or("", |(whole, _)| whole);
    let drawn = whole.rsplit_once("\x1b[H");
    drawn.map_or_else(Vec::new, |(_, frame)| frame.split("\r\n").map(plain).collect())
}

fn plain(line: &str) -> String {
    let mut parts = line.split("\x1b[");
    let first = parts.next().unwrap_or_default().to_owned();
    // The terminal ends a line by a carriage return of its own.
    let text = parts.fold(first, |text, part| {
        text + part.trim_start_matches(|c: char| c.is_ascii_digit() || c == ';').get(1..).unwrap_or_default()
    });
    text.trim_end_matches('\r').to_owned()
}

const DEMO: [&str; 3] = ["demo", "--listen", "127.0.0.1:0"];

#[test]
fn at_a_terminal_of_80_columns_what_to_try_stays_in_view_and_what_was_reached_stays_afterwards() {
    let world = World::new();
    let demo = Terminal::run(&world, &DEMO, [24, 80], |_| {});
    let drawn = eventually("rates are drawn", || {
        let drawn = last_drawn(&demo.written());
        let row = drawn.iter().find(|line| line.starts_with("host/ascan "));
        if row.is_some_and(|row| row.contains("Hz")) { Ok(drawn) } else { Err(demo.written()) }
    });
    let text = drawn.join("\n");
    assert!(drawn.len() <= 24 && drawn.iter().all(|line| line.chars().count() <= 80), "{text}");
    assert!(drawn[0].starts_with("trocar demo bscan is running, listening on 127.0.0.1:"), "{text}");
    for what in [
        "picture http://127.0.0.1:",
        "viewer http://127.0.0.1:",
        "trocar ls --gcm",
        "GcmService/List",
        "InteractService/Invoke",
    ] {
        assert!(drawn[1..6].iter().any(|line| line.contains(what)), "{what}: {text}");
    }
    let heads = drawn.iter().find(|line| line.starts_with("COMPONENT ")).unwrap_or_else(|| panic!("{text}"));
    assert!(heads.contains("RATE") && heads.contains("SKIPPED"), "a column is whole or left out: {text}");

    let written = demo.interrupted();
    let (_, after) = written.rsplit_once("\x1b[?1049l").expect("the other screen is left");
    assert!(after.contains("robot ") && after.contains(" steps in ") && after.contains("video "), "{after}");
    assert!(!after.contains("\x1b[H"), "nothing is drawn over it: {after}");
    assert_eq!(written.matches("\x1b[?1049h").count(), 1, "one screen");
}

#[test]
fn what_the_machine_refused_while_it_came_up_is_in_view_and_on_record_afterwards() {
    let world = World::new();
    let demo = Terminal::run(&world, &DEMO, [30, 100], |command| limit(command, &[(libc::RLIMIT_RTPRIO, 0)]));
    let warned = |line: &String| line.starts_with("warning: host/") && line.contains("real-time priority");
    // Also when later warnings have come.
    let drawn = eventually("the refusal is drawn below the rates", || {
        let drawn = last_drawn(&demo.written());
        let has_rates = drawn.iter().any(|line| line.starts_with("host/ascan ") && line.contains("Hz"));
        if has_rates && drawn.iter().any(warned) { Ok(drawn) } else { Err(demo.written()) }
    });
    // Every thread is refused the same, which is one line.
    assert!(drawn.iter().any(|line| line.starts_with("1 warning while it came up:")), "{drawn:#?}");
    assert!(drawn[0].starts_with("trocar demo bscan is running"), "{drawn:#?}");
    let written = demo.interrupted();
    let (before, _) = written.split_once("\x1b[?1049h").expect("there is a screen");
    assert!(
        !before.contains("warning"),
        "nothing is written below the screen, where nobody sees it: {before}"
    );
    let (_, after) = written.rsplit_once("\x1b[?1049l").expect("the other screen is left");
    assert!(after.contains("warning: host/") && after.contains("; likewise host/"), "{after}");
}

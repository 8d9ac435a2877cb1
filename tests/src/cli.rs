//! The built `trocar` as a script calls it: run to its end, output and exit code kept.
//!
//! Invariant: never inherits TROCAR_GCM, the terminal or the user's state directory.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::{Built, World};

/// A short-lived `trocar` command line.
pub struct Trocar {
    gcm: Option<String>,
    dir: PathBuf,
    state_home: PathBuf,
    prepare: fn(&mut Command),
}

/// What one command left.
#[derive(Clone, Debug)]
pub struct Output {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
    line: String,
}

impl Trocar {
    /// In the world's directory, with no GCM named.
    #[must_use]
    pub fn new(world: &World) -> Self {
        Self { gcm: None, dir: world.path(""), state_home: world.path("xdg-state"), prepare: |_| () }
    }

    /// Aimed at a served address.
    #[must_use]
    pub fn at(world: &World, address: &str) -> Self {
        Self { gcm: Some(address.to_owned()), ..Self::new(world) }
    }

    #[must_use]
    pub fn in_dir(mut self, dir: &Path) -> Self {
        self.dir = dir.to_path_buf();
        self
    }

    /// With its command prepared: limits, rights.
    #[must_use]
    pub fn prepared(mut self, prepare: fn(&mut Command)) -> Self {
        self.prepare = prepare;
        self
    }

    pub fn run<S: AsRef<OsStr>>(&self, args: &[S]) -> Output {
        let mut command = Command::new(Built::trocar());
        command.args(args);
        let typed = args.iter().map(|a| a.as_ref().to_string_lossy().into_owned());
        self.ran(command, format!("trocar {}", typed.collect::<Vec<_>>().join(" ")))
    }

    /// A line as a person types it in a shell, where `trocar` is the built one.
    pub fn types(&self, line: &str) -> Output {
        let mut command = Command::new("sh");
        let path = std::env::var("PATH").unwrap_or_default();
        command.args(["-c", line]).env("PATH", format!("{}:{path}", Built::dir().display()));
        self.ran(command, line.to_owned())
    }

    fn ran(&self, mut command: Command, line: String) -> Output {
        command.current_dir(&self.dir).stdin(Stdio::null());
        command.env("XDG_STATE_HOME", &self.state_home).env_remove("TROCAR_GCM").env("NO_COLOR", "1");
        if let Some(gcm) = &self.gcm {
            command.env("TROCAR_GCM", gcm);
        }
        (self.prepare)(&mut command);
        let output = command.output().unwrap_or_else(|e| panic!("cannot start `{line}`: {e}"));
        Output {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
            line,
        }
    }
}

impl Output {
    /// Checks the exit code.
    ///
    /// # Panics
    /// With the command line and all it printed.
    #[track_caller]
    pub fn ends_with(self, code: i32) -> Self {
        assert!(self.code == code, "`{}` ended with {}, expected {code}\n{self:#?}", self.line, self.code);
        self
    }

    /// Checks that a text was printed on either stream.
    ///
    /// # Panics
    /// With the command line and all it printed.
    #[track_caller]
    pub fn says(self, text: &str) -> Self {
        let all = format!("{}{}", self.stdout, self.stderr).to_lowercase();
        assert!(all.contains(&text.to_lowercase()), "`{}` does not say {text:?}\n{self:#?}", self.line);
        self
    }

    /// Standard output as JSON.
    ///
    /// # Panics
    /// When it is not.
    #[must_use]
    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|e| panic!("`{}` did not print JSON: {e}\n{self:#?}", self.line))
    }
}

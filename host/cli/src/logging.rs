//! Destinations of log lines: stderr for people, rotated files in the state directory for later.
//!
//! Invariant: a full disk or a closed stderr never stops the program; the level that is recorded is never
//! coarser than the one shown. Components drive none of the process's own lines out, who asked for what among
//! them.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use log::{Level, LevelFilter, Log, Metadata, Record};
use parking_lot::Mutex;
use trocar_rt::os;

use super::logs::clock;
use super::out::{self, paragraph};
use super::units::count;
use trocar::journal::time;
use trocar::lcm::LogLine;

/// Size at which a file becomes the old one, bytes; two are kept.
const ROTATE_BYTES: u64 = 4 << 20;
const FILE: &str = "trocar.log";
/// Lines of components, apart from the process's own.
const COMPONENTS: &str = "components.log";
/// File of requests and their callers alone: other lines do not drive them out.
const AUDIT: &str = "audit.log";

/// Lines of the start that are kept for [`to_readers`].
const EARLY: usize = 200;

static LOGGER: Logger = Logger {
    shown: Mutex::new(LevelFilter::Warn),
    kept: Mutex::new(None),
    file: Mutex::new(None),
    components: Mutex::new(None),
    audit: Mutex::new(None),
    readers: Mutex::new(Readers::Early(Vec::new())),
};

struct Logger {
    shown: Mutex<LevelFilter>,
    /// Destination of lines instead of stderr, while a screen is drawn there.
    kept: Mutex<Option<Kept>>,
    file: Mutex<Option<Rotating>>,
    components: Mutex<Option<Rotating>>,
    audit: Mutex<Option<Rotating>>,
    readers: Mutex<Readers>,
}

/// Destination of the lines that `trocar logs` asks for; until it is known the lines are kept.
enum Readers {
    Early(Vec<LogLine>),
    Told(Arc<dyn Fn(LogLine) + Send + Sync>),
}

impl Logger {
    /// Calls the reader outside the lock: it may not come back.
    fn tell(&self, line: LogLine) {
        let mut readers = self.readers.lock();
        match &mut *readers {
            Readers::Told(told) => {
                let told = told.clone();
                drop(readers);
                told(line);
            }
            Readers::Early(kept) if kept.len() < EARLY => kept.push(line),
            Readers::Early(_) => {}
        }
    }
}

struct Rotating {
    path: PathBuf,
    file: File,
    bytes: u64,
}

/// Starts logging: `shown` and above to stderr; `TROCAR_LOG` (error … trace) overrides it. Info is
/// always recorded.
pub(super) fn install(shown: LevelFilter) {
    let asked = std::env::var("TROCAR_LOG").ok().and_then(|l| l.parse().ok());
    let shown = asked.unwrap_or(shown);
    *LOGGER.shown.lock() = shown;
    // A second call (several hosts in one process) keeps the first logger.
    let _ = log::set_logger(&LOGGER);
    log::set_max_level(shown.max(LevelFilter::Info));
}

/// Also writes to `<dir>/trocar.log`, what components say to `<dir>/components.log`, and who asked for what
/// to `<dir>/audit.log`, too; when one cannot be opened, says so and goes on.
pub(super) fn to_file(dir: &Path) {
    let Logger { file, components, audit, .. } = &LOGGER;
    for (name, place) in [(FILE, file), (COMPONENTS, components), (AUDIT, audit)] {
        let path = dir.join(name);
        match Rotating::open(path.clone()) {
            Ok(file) => *place.lock() = Some(file),
            Err(e) => log::warn!("no log file: {}: {e}", path.display()),
        }
    }
}

/// Makes the process's own lines readable like those of its components, those since the start, too.
pub(super) fn to_readers(tell: impl Fn(LogLine) + Send + Sync + 'static) {
    let mut readers = LOGGER.readers.lock();
    if let Readers::Early(kept) = &mut *readers {
        std::mem::take(kept).into_iter().for_each(&tell);
    }
    *readers = Readers::Told(Arc::new(tell));
}

/// Lines that a screen shows: what a person was warned of, and the newest of the log.
#[derive(Clone, Default)]
pub(super) struct Kept {
    /// Warnings by [`warn`]: said once, and true as long as the program runs.
    pub(super) lasting: Vec<String>,
    pub(super) newest: VecDeque<String>,
    /// Number of all there were.
    pub(super) all: usize,
}

impl Kept {
    fn push(&mut self, line: &str) {
        self.all += 1;
        if self.newest.len() == EARLY {
            self.newest.pop_front();
        }
        self.newest.push_back(line.trim_end().to_owned());
    }
}

/// While it lives, what would be shown on stderr is kept for a screen; afterwards it is shown there.
pub(super) struct Diverted(());

impl Diverted {
    pub(super) fn begin() -> Diverted {
        *LOGGER.kept.lock() = Some(Kept::default());
        Diverted(())
    }
}

/// Warns of something that holds from now on: on stderr, or among the lines that are kept for a screen.
pub(super) fn warn(text: &str) {
    match LOGGER.kept.lock().as_mut() {
        Some(kept) => kept.lasting.push(format!("warning: {}", paragraph(text))),
        None => out::complain("warning", text),
    }
}

/// The lines that are kept for a screen now.
pub(super) fn kept() -> Kept {
    LOGGER.kept.lock().clone().unwrap_or_default()
}

impl Drop for Diverted {
    fn drop(&mut self) {
        let kept = LOGGER.kept.lock().take().unwrap_or_default();
        let mut text: String = kept.lasting.iter().map(|line| format!("{line}\n")).collect();
        if kept.all > kept.newest.len() {
            let before = count((kept.all - kept.newest.len()) as u64, "line");
            text.push_str(&format!("{before} before these:\n"));
        }
        kept.newest.iter().for_each(|line| text.push_str(&format!("{line}\n")));
        let _ = os::standard_error().write_all(text.as_bytes());
    }
}

impl Rotating {
    fn open(path: PathBuf) -> std::io::Result<Self> {
        let file = File::options().create(true).append(true).open(&path)?;
        let bytes = file.metadata()?.len();
        Ok(Self { path, file, bytes })
    }

    fn write(&mut self, line: &str) -> std::io::Result<()> {
        if self.bytes > ROTATE_BYTES {
            fs::rename(&self.path, self.path.with_extension("log.1"))?;
            *self = Self::open(self.path.clone())?;
        }
        self.file.write_all(line.as_bytes())?;
        self.bytes += line.len() as u64;
        Ok(())
    }
}

impl Log for Logger {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        let target = metadata.target();
        let ours = matches!(target, "component" | "plugin" | "audit") || target.starts_with("trocar");
        ours || metadata.level() <= Level::Warn
    }

    fn log(&self, record: &Record<'_>) {
        if !self.enabled(record.metadata()) {
            return;
        }
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos() as u64);
        let said = record.args().to_string();
        let text = format!("{:5} {}\n", record.level(), paragraph(&said));
        // A file is read on another day.
        let dated = format!("{} {text}", time(now));
        if record.level() <= *self.shown.lock() {
            let shown = || format!("{}Z {text}", clock(now));
            let mut stderr = os::standard_error();
            match self.kept.lock().as_mut() {
                Some(kept) => kept.push(&shown()),
                None if std::io::stderr().is_terminal() => _ = stderr.write_all(shown().as_bytes()),
                None => _ = stderr.write_all(dated.as_bytes()),
            }
        }
        let place = match record.target() {
            "component" | "plugin" => &self.components,
            _ => &self.file,
        };
        let audit = (record.target() == "audit").then_some(&self.audit);
        for place in std::iter::once(place).chain(audit) {
            if let Some(file) = place.lock().as_mut() {
                let _ = file.write(&dated);
            }
        }
        // The LCM sends the log lines of components.
        if record.target() != "component" {
            let line = LogLine {
                wall_ns: now,
                level: record.level() as u32,
                path: String::new(),
                target: record.target().to_owned(),
                message: said,
            };
            self.tell(line);
        }
    }

    fn flush(&self) {}
}

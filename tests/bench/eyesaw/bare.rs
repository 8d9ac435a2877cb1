//! A program that does nothing but write bytes to a file: what any recorder has to do, and nothing else.
//!
//! Invariant: what it writes comes from memory of its own, a picture each 33 ms and the rest in between; its
//! file goes with it.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// A pair of images of the canonical load, bytes.
const PICTURE: usize = 2 * 1024 * 768 * 3;
const PICTURES_PER_S: f64 = 30.0;
/// Writes between two pictures.
const SMALL: usize = 2;

pub(super) struct BareWriter {
    path: PathBuf,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl BareWriter {
    pub(super) fn begin(path: &Path, bytes_per_s: f64) -> BareWriter {
        let file = File::create_new(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let ends = Arc::new(AtomicBool::new(false));
        let ended = ends.clone();
        let thread = thread::spawn(move || write(file, bytes_per_s, &ended));
        BareWriter { path: path.to_owned(), ends, thread: Some(thread) }
    }
}

fn write(mut file: File, bytes_per_s: f64, ended: &AtomicBool) {
    let picture = vec![7u8; PICTURE];
    let rest = (bytes_per_s / PICTURES_PER_S - PICTURE as f64).max(0.0) as usize;
    let small = vec![5u8; rest / SMALL];
    let pause = Duration::from_secs_f64(1.0 / PICTURES_PER_S / (SMALL + 1) as f64);
    let mut due = Instant::now();
    while !ended.load(Ordering::Relaxed) {
        for bytes in std::iter::once(&picture).chain(std::iter::repeat_n(&small, SMALL)) {
            file.write_all(bytes).expect("room on the disk");
            due += pause;
            thread::sleep(due.saturating_duration_since(Instant::now()));
        }
    }
}

impl Drop for BareWriter {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        let _ = fs::remove_file(&self.path);
    }
}

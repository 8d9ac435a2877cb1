//! A window with a display's frames, in a thread of its own.
//!
//! Invariant: the display library is looked for when a window is opened, and what goes wrong then is told; a
//! window that people close stays closed until the next Start; a stale picture is marked. The library ends
//! the process when the display server dies: run a display with a window in a process of its own.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use trocar_imaging::side;
use trocar_sdk::{Host, Result};

use crate::drawing::Drawing;
use crate::freshness::Freshness;
use crate::handoff::{Giver, pair};

/// The settings that a window is opened with.
pub(crate) struct Settings {
    pub(crate) title: String,
    /// Name of its thread.
    pub(crate) thread: String,
    /// Size of the first frame, more or less; the window can be resized.
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) max_bytes: usize,
    pub(crate) host: Host,
    /// The age of the newest frame.
    pub(crate) freshness: Arc<Freshness>,
}

/// An open window; dropped, it is closed.
pub(crate) struct Window {
    open: Arc<AtomicBool>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Window {
    /// Opens a window.
    ///
    /// # Errors
    /// There is no display, or no library for it, or the plugin was built without windows.
    pub(crate) fn open(settings: Settings) -> Result<(Window, Giver)> {
        let open = Arc::new(AtomicBool::new(true));
        let ends = Arc::new(AtomicBool::new(false));
        let (giver, taker) = pair(settings.max_bytes);
        let drawing = Drawing::new(taker, settings.freshness.clone());
        let (shown, ending) = (open.clone(), ends.clone());
        let (told, tells) = std::sync::mpsc::channel();
        let name = settings.thread.clone();
        let thread = side::spawn(&name, move || {
            run(&settings, drawing, &ending, |opened| {
                let _ = told.send(opened);
            });
            shown.store(false, Ordering::Release);
        })
        .map_err(|why| format!("no thread for the window: {why}"))?;
        let window = Window { open, ends, thread: Some(thread) };
        match tells.recv() {
            Ok(Ok(())) => Ok((window, giver)),
            Ok(Err(why)) => Err(why.into()),
            Err(_) => Err("the window's thread panicked".into()),
        }
    }

    /// False when people have closed it.
    pub(crate) fn is_open(&self) -> bool {
        self.open.load(Ordering::Acquire)
    }
}

impl Drop for Window {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(not(feature = "window"))]
fn run(_: &Settings, _: Drawing, _: &AtomicBool, told: impl FnOnce(std::result::Result<(), String>)) {
    told(Err(
        "window: this plugin was built without its feature `window`; build it with that, or open /video of the host"
            .into(),
    ));
}

#[cfg(feature = "window")]
fn run(
    settings: &Settings,
    mut drawing: Drawing,
    ends: &AtomicBool,
    told: impl FnOnce(std::result::Result<(), String>),
) {
    let Settings { title, width, height, host, .. } = settings;
    let options = minifb::WindowOptions {
        resize: true,
        scale_mode: minifb::ScaleMode::AspectRatioStretch,
        ..minifb::WindowOptions::default()
    };
    let mut window = match minifb::Window::new(title, *width, *height, options) {
        Ok(window) => {
            told(Ok(()));
            window
        }
        Err(why) => {
            let display = std::env::var("DISPLAY").unwrap_or_default();
            let on = if display.is_empty() {
                "DISPLAY is not set".to_owned()
            } else {
                format!("DISPLAY is {display}")
            };
            return told(Err(format!(
                "window: none can be opened ({why}; {on}): start the host where there is an X11 display and its \
                 library (libX11), or open /video of the host in a browser"
            )));
        }
    };
    let mut shown = Vec::new();
    while window.is_open() && !ends.load(Ordering::Acquire) {
        let Some((pixels, width, height)) = drawing.next(host.now()) else {
            window.update();
            std::thread::sleep(std::time::Duration::from_millis(4));
            continue;
        };
        shown.clear();
        shown.extend(pixels.as_chunks::<3>().0.iter().map(|[r, g, b]| u32::from_be_bytes([0, *r, *g, *b])));
        // A frame that cannot be shown is left out.
        let _ = window.update_with_buffer(&shown, width, height);
    }
}

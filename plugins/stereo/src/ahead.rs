//! Work that threads do for the simulated source before it is due: the picture at rest, and pairs without a
//! tool.
//!
//! Invariant: a bare pair is a function of its stamp and number, so it is the same whoever draws it, and
//! when. The step neither waits nor wakes: it asks, and later takes what is there.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use trocar_imaging::side;
use trocar_phantom::World;
use trocar_phantom::camera::Rig;
use trocar_phantom::render::{Renderer, Scene, Side};
use trocar_sdk::prelude::*;

/// Buffers that go round. With one there is no wish while an earlier one is not fulfilled: on a busy machine,
/// where the step draws what is late itself, nothing piles up.
const BUFFERS: usize = 1;
/// The thread looks so often whether it is asked, once a wish may come.
const LOOKS: Duration = Duration::from_millis(1);
/// The thread sleeps at most so long: its end waits for that.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// A pair, or the wish for one: both pictures' rows of red, green, blue, the left one's first.
#[derive(Default)]
pub(crate) struct Bare {
    pub(crate) stamp: Stamp,
    pub(crate) number: u64,
    pub(crate) rgb: Vec<u8>,
}

/// The step's end; dropped, the thread ends.
pub(crate) struct Ahead {
    wishes: SyncSender<Bare>,
    drawn: Receiver<Bare>,
    /// Buffers that nobody uses at the moment.
    spare: Vec<Vec<u8>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Ahead {
    /// Starts the thread, with a renderer of its own.
    ///
    /// # Errors
    /// The system has no thread for it.
    pub(crate) fn start(name: &str, mut renderer: Renderer) -> Result<Ahead> {
        let camera = renderer.rig().cameras[0];
        let bytes = 2 * 3 * camera.width * camera.height;
        let (wishes, wished) = sync_channel::<Bare>(BUFFERS);
        let (draws, drawn) = sync_channel(BUFFERS);
        let ends = Arc::new(AtomicBool::new(false));
        let ending = ends.clone();
        let thread = side::spawn(name, move || {
            let mut beat = Beat::default();
            while !ending.load(Ordering::Acquire) {
                match wished.try_recv() {
                    Ok(mut bare) => {
                        let next = Instant::now() + beat.quiet_after(&bare);
                        draw(&mut renderer, &mut bare);
                        // There is room for all buffers.
                        let _ = draws.try_send(bare);
                        std::thread::sleep(next.saturating_duration_since(Instant::now()));
                    }
                    Err(TryRecvError::Empty) => std::thread::sleep(LOOKS),
                    Err(TryRecvError::Disconnected) => return,
                }
            }
        })
        .map_err(|why| format!("no thread to draw ahead: {why}"))?;
        Ok(Ahead { wishes, drawn, spare: vec![vec![0; bytes]; BUFFERS], ends, thread: Some(thread) })
    }

    /// Wishes for a pair. Without a buffer nothing happens: the pair is drawn when it is due.
    pub(crate) fn wish(&mut self, stamp: Stamp, number: u64) {
        let Some(rgb) = self.spare.pop() else { return };
        // There is room for all buffers.
        let _ = self.wishes.try_send(Bare { stamp, number, rgb });
    }

    /// The pair of this number, if it is there and its stamp is one that `fits`.
    pub(crate) fn take(&mut self, number: u64, fits: impl Fn(Stamp) -> bool) -> Option<Bare> {
        while let Ok(bare) = self.drawn.try_recv() {
            if bare.number == number && fits(bare.stamp) {
                return Some(bare);
            }
            self.give_back(bare);
        }
        None
    }

    pub(crate) fn give_back(&mut self, bare: Bare) {
        // Never more than there were, so this does not allocate.
        self.spare.push(bare.rgb);
    }
}

/// When wishes come: each look is a timer that interrupts whoever runs there, so there are few while there is
/// none to come.
#[derive(Default)]
struct Beat {
    /// Stamp, ns, and number of the wish before.
    before: Option<(u64, u64)>,
}

impl Beat {
    /// Time after this wish in which there is certainly no other one: most of the time between two frames.
    /// Wishes that were left out count by their numbers.
    fn quiet_after(&mut self, wish: &Bare) -> Duration {
        let now = (wish.stamp.ns(), wish.number);
        let Some(before) = self.before.replace(now) else { return Duration::ZERO };
        let frames = now.1.checked_sub(before.1).filter(|frames| *frames > 0);
        let frame_ns = frames.map_or(0, |frames| now.0.saturating_sub(before.0) / frames);
        LONGEST_SLEEP.min(Duration::from_nanos(frame_ns - frame_ns / 16))
    }
}

impl Drop for Ahead {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A picture at rest in the making: on an ordinary thread, which may use all processors.
pub(crate) struct Tracing(Option<JoinHandle<Renderer>>);

impl Tracing {
    /// # Errors
    /// The system has no thread for it.
    pub(crate) fn begin(name: &str, world: World, rig: Rig) -> Result<Tracing> {
        let thread = side::spawn(name, move || Renderer::new(world, rig));
        Ok(Tracing(Some(thread.map_err(|why| format!("no thread to trace the picture at rest: {why}"))?)))
    }

    /// Waits for it; none when it panicked.
    pub(crate) fn done(mut self) -> Option<Renderer> {
        self.0.take()?.join().ok()
    }
}

impl Drop for Tracing {
    /// No thread outlives the code that it runs.
    fn drop(&mut self) {
        if let Some(thread) = self.0.take() {
            let _ = thread.join();
        }
    }
}

fn draw(renderer: &mut Renderer, bare: &mut Bare) {
    let scene = Scene { t_s: bare.stamp.ns() as f64 * 1e-9, number: bare.number, tool: None };
    let half = bare.rgb.len() / 2;
    for (side, to) in [Side::Left, Side::Right].into_iter().zip(bare.rgb.chunks_exact_mut(half)) {
        renderer.draw(side, &scene, |y, row| to[y * row.len()..][..row.len()].copy_from_slice(row));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_sleeps_for_most_of_a_frame_however_many_wishes_were_left_out() {
        let mut beat = Beat::default();
        let mut after = |ms: u64, number| {
            beat.quiet_after(&Bare { stamp: Stamp::from_ns(ms * 1_000_000), number, rgb: Vec::new() })
        };
        assert_eq!(after(100, 3), Duration::ZERO, "nothing is known after the first");
        assert_eq!(after(116, 4), Duration::from_millis(15));
        assert_eq!(after(164, 7), Duration::from_millis(15), "three frames later");
        assert_eq!(after(164, 7), Duration::ZERO, "the same once more");
        assert_eq!(after(180, 1), Duration::ZERO, "numbers begin again");
        assert_eq!(after(10_180, 2), LONGEST_SLEEP);
    }
}

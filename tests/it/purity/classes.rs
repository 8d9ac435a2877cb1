//! Components that do in each step all that a step may do.

use super::book::{self, Watch};
use trocar_sdk::data::{ImageHeader, Scalar};
use trocar_sdk::prelude::*;
use trocar_sdk::{StaticPlugin, static_plugin};

/// Bytes of a frame, and of a row of it.
const FRAME: usize = 1 << 16;
const ROW: usize = 1 << 10;

pub(super) const CLASSES: StaticPlugin = static_plugin!(name = "purity", Worker, Device, Camera, Filter);

#[derive(Config)]
struct Cfg {
    /// Number of the watch over its thread; 0 = none
    #[config(default = 0)]
    watch: u64,
}

impl Cfg {
    fn watch(&self) -> Option<&'static Watch> {
        book::numbered(self.watch)
    }
}

/// Writes, sends, calls, reads, emits, takes and logs in each step.
#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl"), requires("peer"), optional("peer"))]
struct Worker {
    #[input(optional)]
    latest: In<Scalar>,
    #[input(optional, fifo = 16)]
    queue: In<Scalar>,
    #[output]
    out: Out<Scalar>,
    #[required(interface = "peer", optional)]
    write: Function<f64>,
    #[required(interface = "peer", optional)]
    twice: Function<f64, f64>,
    #[required(interface = "peer", optional)]
    value: Function<(), f64>,
    #[event("ctl")]
    told: Event<f64>,
    #[state]
    steps: u64,
    #[state]
    value_now: f64,
    #[state]
    heard: u64,
    #[state]
    row: [f64; 100],
    watch: Option<&'static Watch>,
    #[config]
    cfg: Cfg,
}

impl Worker {
    fn work(&mut self) {
        self.steps += 1;
        if let Some(sample) = self.latest.fresh() {
            self.row[0] = sample.value;
        }
        while let Some(sample) = self.queue.next() {
            self.row[1] = sample.value;
        }
        self.out.write(&Scalar { value: self.steps as f64, ..Scalar::default() });
        self.write.send(self.steps as f64);
        if let Ok(value) = self.value.call(()) {
            self.row[2] = value;
        }
        // From here to another thread it is refused, which costs nothing either.
        if let Ok(value) = self.twice.call(2.0) {
            self.row[3] = value;
        }
        self.told.emit(self.steps as f64);
        if self.steps.is_multiple_of(100) {
            log::info!("step {}", self.steps);
        }
    }
}

#[provides("ctl")]
impl Worker {
    #[command]
    fn write(&mut self, value: f64) {
        book::inside(|| self.value_now = value);
    }
    #[command]
    fn twice(&mut self, value: f64) -> f64 {
        book::inside(|| 2.0 * value)
    }
    #[read]
    fn value(s: &WorkerState) -> f64 {
        s.value_now
    }
}

#[handles("peer")]
impl Worker {
    #[on(optional)]
    fn told(&mut self, _: f64) {
        book::inside(|| self.heard += 1);
    }
}

impl Component for Worker {
    fn configure(&mut self) -> Result {
        self.watch = self.cfg.watch();
        Ok(())
    }
    fn step(&mut self, _: &Tick) -> Result {
        match self.watch {
            Some(watch) => watch.step(|| self.work()),
            None => book::inside(|| self.work()),
        }
        Ok(())
    }
}

/// A device with a thread of its own that calls back.
#[derive(Component)]
#[component(model = "on_callback", provides("ctl"))]
struct Device {
    #[output]
    out: Out<Scalar>,
    #[event("ctl")]
    told: Event<u64>,
    #[state]
    calls: u64,
    thread: Option<std::thread::JoinHandle<()>>,
    #[host]
    host: Host,
    #[config]
    cfg: Cfg,
}

#[provides("ctl")]
impl Device {
    #[read]
    fn calls(s: &DeviceState) -> u64 {
        s.calls
    }
}

impl Component for Device {
    fn start(&mut self) -> Result {
        let (host, watch) = (self.host.clone(), self.cfg.watch().ok_or("it is not watched")?);
        let (out, told) = (std::mem::take(&mut self.out), std::mem::take(&mut self.told));
        self.thread = Some(std::thread::spawn(move || {
            let mut calls = 0;
            while !watch.is_done() {
                let entered = host.callback(|| {
                    watch.step(|| {
                        calls += 1;
                        out.write(&Scalar { value: calls as f64, ..Scalar::default() });
                        told.emit(calls);
                    });
                });
                if entered.is_err() {
                    std::hint::spin_loop();
                }
            }
        }));
        Ok(())
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Fills a frame in each step.
#[derive(Component)]
#[component(model = "stream", rate_hz = 1000)]
struct Camera {
    #[output]
    frame: Out<Frame<ImageHeader>>,
    #[state]
    frames: u64,
    watch: Option<&'static Watch>,
    #[config]
    cfg: Cfg,
}

impl Camera {
    fn shoot(&mut self) -> Result {
        let mut frame = self.frame.loan()?;
        self.frames += 1;
        frame.header_mut().width = ROW as u32;
        frame.bytes_mut()[0] = self.frames as u8;
        frame.commit(FRAME, Stamp::INVALID);
        Ok(())
    }
}

impl Component for Camera {
    fn configure(&mut self) -> Result {
        self.watch = self.cfg.watch();
        self.frame.reserve(FRAME, 4)
    }
    fn step(&mut self, _: &Tick) -> Result {
        match self.watch {
            Some(watch) => watch.step(|| self.shoot()),
            None => book::inside(|| self.shoot()),
        }
    }
}

/// Changes a frame in place, or a copy of it, with as many threads as there are, and passes it on.
#[derive(Component)]
#[component(model = "on_signal")]
struct Filter {
    #[input]
    frame: In<Frame<ImageHeader>>,
    #[output]
    frame_out: Out<Frame<ImageHeader>>,
    #[state]
    frames: u64,
    /// Frames of which somebody else held a handle.
    #[state]
    copies: u64,
    watch: Option<&'static Watch>,
    #[host]
    host: Host,
    #[config]
    cfg: Cfg,
}

impl Filter {
    fn filter(&mut self) -> Result {
        let Some(mut frame) = self.frame.next() else { return Ok(()) };
        self.frames += 1;
        let watch = self.watch;
        let invert = |_, rows: &mut [u8]| {
            let work = || rows.iter_mut().for_each(|b| *b = !*b);
            match watch {
                Some(watch) => watch.helps(work),
                None => book::inside(work),
            }
        };
        if let Some(bytes) = frame.bytes_mut() {
            self.host.par_rows(bytes, ROW, invert)?;
            self.frame_out.forward(&frame);
            return Ok(());
        }
        self.copies += 1;
        let mut copy = self.frame_out.loan()?;
        *copy.header_mut() = *frame.header();
        let bytes = &mut copy.bytes_mut()[..FRAME];
        bytes.copy_from_slice(frame.bytes());
        self.host.par_rows(bytes, ROW, invert)?;
        copy.commit(FRAME, frame.stamp());
        Ok(())
    }
}

impl Component for Filter {
    fn configure(&mut self) -> Result {
        self.watch = self.cfg.watch();
        self.frame_out.reserve(FRAME, 4)
    }
    fn step(&mut self, _: &Tick) -> Result {
        match self.watch {
            Some(watch) => watch.step(|| self.filter()),
            None => book::inside(|| self.filter()),
        }
    }
}

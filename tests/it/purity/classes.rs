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

/// Two numbers.
#[derive(Payload, Clone, Copy, Default)]
#[repr(C)]
struct Pair {
    left: f64,
    right: f64,
}

/// The same, the other way round: what an `adapt`ing connection makes of a `Pair`.
#[derive(Payload, Clone, Copy, Default)]
#[repr(C)]
struct Turned {
    right: f64,
    left: f64,
}

/// Writes, sends, calls, reads, emits, takes and logs in each step, through ports with a type and without.
#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl"), requires("peer"), optional("peer"))]
struct Worker {
    #[input(optional)]
    latest: In<Scalar>,
    #[input(optional, fifo = 16)]
    queue: In<Scalar>,
    #[output]
    out: Out<Scalar>,
    #[input(optional)]
    turned: In<Turned>,
    #[output]
    pair: Out<Pair>,
    #[input(optional, fifo = 16)]
    any: AnyIn,
    #[output]
    any_out: AnyOut,
    /// What an `any_out` writes.
    #[input(optional, fifo = 16)]
    back: In<Scalar>,
    #[required(interface = "any_peer", name = "add", optional)]
    any_call: AnyFunction,
    #[required(interface = "peer", optional)]
    write: Function<f64>,
    #[required(interface = "peer", optional)]
    twice: Function<f64, f64>,
    #[required(interface = "peer", optional)]
    value: Function<(), f64>,
    #[event("ctl")]
    told: Event<f64>,
    #[event("ctl")]
    at_once: Event<f64>,
    #[state]
    steps: u64,
    #[state]
    value_now: f64,
    #[state]
    heard: u64,
    /// What was really done of what is not done in every model.
    #[state]
    done: Done,
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
        self.note(self.write.send(self.steps as f64));
        if let Ok(value) = self.value.call(()) {
            self.row[2] = value;
        }
        // From here to another thread it is refused, which costs nothing either.
        if let Ok(value) = self.twice.call(2.0) {
            self.row[3] = value;
        }
        self.told.emit(self.steps as f64);
        self.at_once.emit(self.steps as f64);
        self.work_adapted();
        self.work_untyped();
        if self.steps.is_multiple_of(100) {
            log::info!("step {}", self.steps);
        }
    }

    /// A queue that was full wakes its server at once.
    fn note(&self, sent: Outcome) {
        if let (Outcome::QueueFull, Some(watch)) = (sent, self.watch) {
            watch.was_refused();
        }
    }

    fn work_adapted(&mut self) {
        self.pair.write(&Pair { left: self.steps as f64, right: 0.5 });
        if let Some(turned) = self.turned.fresh() {
            self.done.adapted += u64::from(turned.right == 0.5);
        }
    }

    fn work_untyped(&mut self) {
        self.done.any_came += bridge(&mut self.any, &mut self.any_out);
        let (sent, called) = call_any(&self.any_call);
        self.note(sent);
        self.done.any_called += called;
        while let Some(sample) = self.back.next() {
            self.row[4] = sample.value;
            self.done.came_back += 1;
        }
    }
}

/// Sends on what came, as a bridge would: its bytes, then the sample itself. How many there were.
fn bridge(any: &mut AnyIn, out: &mut AnyOut) -> u64 {
    let mut came = 0;
    while let Some(sample) = any.next() {
        out.write_bytes(sample.value(), sample.stamp());
        out.forward(&sample);
        came += 1;
    }
    came
}

/// Sends and calls with bytes that are not aligned, as those of a packet are not: what became of the send,
/// and 1 when the call was answered. From here to another thread it is refused, which costs nothing either.
fn call_any(call: &AnyFunction) -> (Outcome, u64) {
    let mut room = [0; 17];
    room[1..9].copy_from_slice(&2.5_f64.to_ne_bytes());
    let (arg, ret) = room.split_at_mut(9);
    let sent = call.send_bytes(&arg[1..]);
    (sent, u64::from(call.call_into(&arg[1..], ret).is_ok()))
}

/// Counts of what worked.
#[derive(Payload, Clone, Copy, Default)]
#[repr(C)]
struct Done {
    /// Samples of another layout that came.
    adapted: u64,
    /// What came from a peer's `any_out`, which has it from its `any`.
    came_back: u64,
    /// Samples at `any`.
    any_came: u64,
    /// Calls by `any_call` that were answered.
    any_called: u64,
    /// Calls and sends of a peer's `any_call`.
    added: u64,
    /// Runs of the direct handler.
    at_once: u64,
}

#[provides("ctl")]
impl Worker {
    #[command]
    fn add(&mut self, value: f64) -> f64 {
        book::inside(|| {
            self.done.added += 1;
            self.value_now + value
        })
    }
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
    #[on(optional, direct)]
    fn at_once(&mut self, _: f64) {
        book::inside(|| self.done.at_once += 1);
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
    #[input(optional)]
    turned: In<Turned>,
    #[input(optional, fifo = 16)]
    any: AnyIn,
    #[output]
    any_out: AnyOut,
    #[required(interface = "any_peer", name = "add", optional)]
    any_call: AnyFunction,
    #[event("ctl")]
    told: Event<f64>,
    #[event("ctl")]
    at_once: Event<f64>,
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
        use std::mem::take;
        let (host, watch) = (self.host.clone(), self.cfg.watch().ok_or("it is not watched")?);
        let (out, told, at_once) = (take(&mut self.out), take(&mut self.told), take(&mut self.at_once));
        let (mut turned, mut any) = (take(&mut self.turned), take(&mut self.any));
        let (mut any_out, any_call) = (take(&mut self.any_out), take(&mut self.any_call));
        self.thread = Some(std::thread::spawn(move || {
            let mut calls = 0;
            while !watch.is_done() {
                let entered = host.callback(|| {
                    watch.step(|| {
                        calls += 1;
                        out.write(&Scalar { value: calls as f64, ..Scalar::default() });
                        told.emit(calls as f64);
                        // Peers that count show what came of it.
                        if turned.fresh().is_some_and(|turned| turned.right == 0.5) {
                            at_once.emit(calls as f64);
                        }
                        bridge(&mut any, &mut any_out);
                        call_any(&any_call);
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

/// Fills a frame in each step, and is to a worker in its stream what another worker is.
#[derive(Component)]
#[component(model = "stream", rate_hz = 1000, provides("ctl"))]
struct Camera {
    #[output]
    frame: Out<Frame<ImageHeader>>,
    #[output]
    out: Out<Scalar>,
    #[output]
    pair: Out<Pair>,
    #[event("ctl")]
    at_once: Event<f64>,
    #[state]
    frames: u64,
    #[state]
    done: Done,
    watch: Option<&'static Watch>,
    #[config]
    cfg: Cfg,
}

#[provides("ctl")]
impl Camera {
    #[command]
    fn add(&mut self, value: f64) -> f64 {
        book::inside(|| {
            self.done.added += 1;
            self.frames as f64 + value
        })
    }
}

impl Camera {
    fn shoot(&mut self) -> Result {
        let value = self.frames as f64;
        self.out.write(&Scalar { value, ..Scalar::default() });
        self.pair.write(&Pair { left: value, right: 0.5 });
        self.at_once.emit(value);
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

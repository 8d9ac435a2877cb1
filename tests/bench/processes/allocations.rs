//! Allocations of the threads of two connected components, in two processes that count them: this program
//! again, as hosts.
//!
//! Invariant: counted is from one step of a component to its next, so all that its thread does in between is
//! in it; counting itself allocates nothing.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::process::{Child, Command, Stdio};

use trocar::model::ExecutionModel;

use trocar_sdk::data::{ImageHeader, Scalar};
use trocar_sdk::prelude::*;
use trocar_sdk::{StaticPlugin, static_plugin};

use super::site::periodic;
use crate::lab::{Lab, model};
use crate::table::Table;

/// First argument of a process that counts.
pub(crate) const HOST: &str = "--host";

/// Steps before those that count, and those that do.
const WARM: u64 = 500;
const STEPS: f64 = 10_000.0;
const FRAME: usize = 1 << 16;

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

#[global_allocator]
static COUNTING: Counting = Counting;

// SAFETY: all is done by the system's allocator; the count is the thread's own and is made without
// allocating.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's promise is the one asked for.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: as above.
        unsafe { System.dealloc(at, layout) }
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: as above.
        unsafe { System.realloc(at, layout, bytes) }
    }
}

const CLASSES: StaticPlugin = static_plugin!(name = "counted", Giver, Taker);

/// What a thread allocated and freed since the first of the steps that count.
#[derive(Default)]
struct Book {
    steps: u64,
    before: u64,
}

impl Book {
    /// Steps that count, and what was allocated and freed in and between them.
    fn step(&mut self) -> (u64, u64) {
        self.steps += 1;
        if self.steps <= WARM {
            self.before = ALLOCATIONS.get();
        }
        (self.steps.saturating_sub(WARM), ALLOCATIONS.get() - self.before)
    }
}

/// Gives samples, frames, commands and events to another process, and reads from it.
#[derive(Component)]
#[component(provides("ctl"))]
struct Giver {
    #[output]
    sample: Out<Scalar>,
    #[output]
    frame: Out<Frame<ImageHeader>>,
    #[event("ctl")]
    told: Event<f64>,
    #[required(interface = "peer", optional)]
    write: Function<f64>,
    #[required(interface = "peer", optional)]
    value: Function<(), f64>,
    #[state]
    steps: u64,
    #[state]
    allocations: u64,
    book: Book,
}

#[provides("ctl")]
impl Giver {}

impl Component for Giver {
    fn configure(&mut self) -> Result {
        self.frame.reserve(FRAME, 8)
    }
    fn step(&mut self, tick: &Tick) -> Result {
        (self.steps, self.allocations) = self.book.step();
        let value = tick.cycle() as f64;
        self.sample.write(&Scalar { value, ..Scalar::default() });
        self.told.emit(value);
        self.write.send(value);
        let _ = self.value.call(());
        if let Ok(frame) = self.frame.loan() {
            frame.commit(FRAME, tick.now());
        }
        Ok(())
    }
}

/// Takes all that, and publishes a row.
#[derive(Component)]
#[component(model = "on_signal", provides("ctl"), requires("source"))]
struct Taker {
    #[input(fifo = 16)]
    sample: In<Scalar>,
    #[input]
    frame: In<Frame<ImageHeader>>,
    #[state]
    steps: u64,
    #[state]
    allocations: u64,
    #[state]
    samples: u64,
    #[state]
    frames: u64,
    #[state]
    heard: u64,
    #[state]
    written: f64,
    book: Book,
}

#[provides("ctl")]
impl Taker {
    #[command]
    fn write(&mut self, value: f64) {
        self.written = value;
    }
    #[read]
    fn value(s: &TakerState) -> f64 {
        s.written
    }
}

#[handles("source")]
impl Taker {
    #[on]
    fn told(&mut self, _: f64) {
        self.heard += 1;
    }
}

impl Component for Taker {
    fn step(&mut self, _: &Tick) -> Result {
        (self.steps, self.allocations) = self.book.step();
        while self.sample.next().is_some() {
            self.samples += 1;
        }
        self.frames += u64::from(self.frame.fresh().is_some());
        Ok(())
    }
}

pub(crate) fn measure(table: &mut Table) {
    let lab = Lab::of_processes();
    let mut hosts = ["giving", "taking"].map(|name| host(name, &lab.address()));
    for (name, class, execution) in [
        ("giving/giver", "giver", periodic(250_000)),
        ("taking/taker", "taker", model(ExecutionModel::OnSignal)),
    ] {
        lab.create_when_offered(name, class, &execution);
    }
    for (client, server) in
        [("taking/taker/sample", "giving/giver/sample"), ("taking/taker/frame", "giving/giver/frame")]
    {
        lab.connect(client, server);
    }
    lab.connect("giving/giver/peer", "taking/taker/ctl");
    lab.connect("taking/taker/source", "giving/giver/ctl");
    lab.start();
    lab.wait_until("giving/giver", "steps", STEPS);
    lab.wait_until("taking/taker", "steps", STEPS);
    table.title("Memory of the threads of two connected components in two processes");
    for (name, whose) in [("giving/giver", "that sends"), ("taking/taker", "that takes")] {
        let (count, steps) = (lab.number(name, "allocations"), lab.number(name, "steps"));
        let what = format!(
            "allocated or freed on the thread of the component {whose} samples, frames, commands and events"
        );
        table.count(&what, &format!("{count}"), "0", count == 0.0, &format!("{steps} steps"));
    }
    let taken = ["samples", "frames", "heard", "written"].map(|field| lab.number("taking/taker", field));
    assert!(taken.iter().all(|n| *n > 0.0), "something did not get there: {taken:?}");
    for host in &mut hosts {
        let _ = host.kill();
        let _ = host.wait();
    }
}

/// This program again as a host with the classes above.
fn host(name: &str, gcm: &str) -> Child {
    let me = std::env::current_exe().expect("this program has a path");
    let mut command = Command::new(me);
    command.args([HOST, name, gcm]).stdin(Stdio::piped()).stdout(Stdio::null());
    command.spawn().expect("this program starts again")
}

/// `--host NAME GCM`: ends with its input.
pub(crate) fn run_host(args: &[String]) {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime can be made");
    let builder = trocar::Host::builder().name(&args[0]).gcm(&args[1]).plugin(CLASSES);
    let host = runtime.block_on(builder.start()).unwrap_or_else(|e| panic!("no host: {e}"));
    let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
    runtime.block_on(host.shutdown());
}

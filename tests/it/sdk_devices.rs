//! Devices as an SDK author writes them, in a real host: one that hangs, one that calls back, and coordinates
//! of ports.
//!
//! Promise: what hangs is made safe without anybody touching it; a callback never waits; coordinates must
//! agree.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::thread::JoinHandle;

use serde_json::{Value, json};
use tokio::runtime::Runtime;
use trocar::model::{PortType, State, Type};
use trocar_sdk::data::{CartesianState, Pose};
use trocar_sdk::prelude::*;
use trocar_sdk::{StaticPlugin, static_plugin};
use trocar_tests::eventually;

/// The motor of the test, as its surroundings see it.
#[derive(Default)]
struct Drive {
    made_safe: AtomicU64,
    hangs: AtomicBool,
}

/// There is one motor at a time, and its step waits here.
static MOTOR: Mutex<Option<Arc<Drive>>> = Mutex::new(None);
static GATE: Mutex<Option<mpsc::Receiver<()>>> = Mutex::new(None);

impl MakeSafe for Drive {
    fn make_safe(&self) -> Result {
        self.made_safe.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

#[derive(Component)]
#[component(rate_hz = 1000, safety = "actuator", safe_from_any_thread, provides("ctl"))]
struct Motor {
    drive: Arc<Drive>,
    /// As many words as a write from elsewhere would be seen in.
    work: [u64; 32],
    #[state]
    steps: u64,
}

#[provides("ctl")]
impl Motor {
    #[read]
    fn steps(s: &MotorState) -> u64 {
        s.steps
    }
}

impl SafeFromAnyThread for Motor {
    fn safe_handle(&self) -> Arc<dyn MakeSafe> {
        *MOTOR.lock().unwrap() = Some(self.drive.clone());
        self.drive.clone()
    }
}

impl Component for Motor {
    fn step(&mut self, _: &Tick) -> Result {
        self.steps += 1;
        self.work = [self.steps; 32];
        if self.drive.hangs.load(Ordering::SeqCst) {
            let gate = GATE.lock().unwrap().take();
            gate.ok_or("it hung once already")?.recv()?;
        }
        if self.work == [self.steps; 32] { Ok(()) } else { Err("somebody else was inside".into()) }
    }
    fn make_safe(&mut self) -> Result {
        panic!("not of a class that is safe from any thread")
    }
}

/// Calls its peer from a thread of its own.
#[derive(Component)]
#[component(model = "on_callback", provides("ctl"))]
struct Device {
    #[required(interface = "peer")]
    ask: Function<(), u64>,
    #[host]
    host: Host,
    #[state]
    seen: u64,
    answers: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

#[provides("ctl")]
impl Device {
    /// Calls out of callbacks that were answered WOULD_BLOCK, and the same ones outside of a callback that
    /// were executed.
    #[command]
    fn answers(&mut self) -> [u64; 2] {
        let answers = self.answers.load(Ordering::SeqCst);
        [answers >> 32, answers & 0xffff_ffff]
    }
}

impl Component for Device {
    fn start(&mut self) -> Result {
        let (host, answers) = (self.host.clone(), self.answers.clone());
        let ask = std::mem::take(&mut self.ask);
        self.thread = Some(std::thread::spawn(move || {
            while answers.load(Ordering::SeqCst) & 0xffff_ffff == 0 {
                let inside = host.callback(|| ask.call(()));
                if let Ok(Err(e)) = inside
                    && e.outcome == Outcome::WouldBlock
                {
                    answers.fetch_add(1 << 32, Ordering::SeqCst);
                    // Out of it, this thread is its own again.
                    answers.fetch_add(u64::from(ask.call(()).is_ok()), Ordering::SeqCst);
                }
            }
        }));
        Ok(())
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.answers.fetch_add(1, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Answers.
#[derive(Component)]
#[component(model = "on_signal", provides("ctl"))]
struct Peer {
    #[state]
    asked: u64,
}

#[provides("ctl")]
impl Peer {
    #[command]
    fn ask(&mut self) -> u64 {
        self.asked += 1;
        self.asked
    }
}

impl Component for Peer {}

/// Poses of the retina.
#[derive(Component)]
#[component(rate_hz = 100, provides("tool"))]
struct Retina {
    #[output]
    #[frame("retina")]
    goal: Out<Pose>,
    #[output]
    #[frame("retina")]
    whole: Out<CartesianState>,
    #[event("tool")]
    #[frame("retina")]
    touched: Event<Pose>,
    #[state]
    #[frame("retina")]
    tip: Pose,
}

#[provides("tool")]
impl Retina {
    #[command]
    fn aim(&mut self, #[frame("retina")] goal: Pose) {
        self.tip = goal;
    }
    #[read]
    #[frame("retina")]
    fn measured_cp(s: &RetinaState) -> Pose {
        s.tip
    }
}

impl Component for Retina {}

/// Wants poses of the robot, but for what it leaves open.
#[derive(Component)]
#[component(rate_hz = 100, optional("told"))]
struct Robot {
    #[input(optional)]
    #[frame("robot")]
    goal: In<Pose>,
    #[input(optional)]
    open: In<Pose>,
    #[input(optional)]
    #[frame("robot")]
    whole: In<CartesianState>,
    #[required(interface = "aims", optional)]
    #[frame("robot")]
    aim: Function<Pose>,
    #[required(interface = "looks", optional)]
    #[frame("robot")]
    measured_cp: Function<(), Pose>,
    #[required(interface = "same", name = "measured_cp", optional)]
    #[frame("retina")]
    same: Function<(), Pose>,
}

#[handles("told")]
impl Robot {
    #[on]
    fn touched(&mut self, #[frame("robot")] _: Pose) {}
}

impl Component for Robot {}

const PLUGIN: StaticPlugin = static_plugin!(name = "devices", Motor, Device, Peer, Retina, Robot);

fn host(runtime: &Runtime) -> trocar::Host {
    runtime.block_on(trocar::Host::builder().name("lab").plugin(PLUGIN).start()).unwrap()
}

fn create(runtime: &Runtime, host: &trocar::Host, name: &str, class: &str) {
    runtime.block_on(host.create(&format!("lab/{name}"), class, json!({}))).unwrap();
}

#[test]
fn a_motor_whose_step_hangs_is_made_safe_by_its_handle_and_nobody_touches_the_motor() {
    let runtime = Runtime::new().unwrap();
    let host = host(&runtime);
    let (open, gate) = mpsc::channel();
    *GATE.lock().unwrap() = Some(gate);
    create(&runtime, &host, "motor", "motor");
    let drive = MOTOR.lock().unwrap().clone().unwrap();
    runtime.block_on(host.start("lab/motor")).unwrap();
    drive.hangs.store(true, Ordering::SeqCst);
    let safe = |n: u64| {
        let drive = drive.clone();
        move || match drive.made_safe.load(Ordering::SeqCst) {
            now if now >= n => Ok(()),
            now => Err(format!("{now} times")),
        }
    };
    eventually("made safe while the step hangs", safe(1));
    // Whoever makes it safe does not wait until that it failed has got around.
    eventually("it is shown as failed", || match runtime.block_on(host.state("lab/motor")).unwrap() {
        State::Fault => Ok(()),
        other => Err(other),
    });
    assert_eq!(drive.made_safe.load(Ordering::SeqCst), 1);
    open.send(()).unwrap();
    eventually("made safe once more by its own thread", safe(2));
    let motor = runtime.block_on(host.describe("lab/motor")).unwrap();
    assert!(motor.fault.contains("it has not come back out of its step"), "{}", motor.fault);
    runtime.block_on(host.shutdown());
}

#[test]
fn a_call_out_of_a_callback_never_waits() {
    let runtime = Runtime::new().unwrap();
    let host = host(&runtime);
    create(&runtime, &host, "device", "device");
    create(&runtime, &host, "peer", "peer");
    runtime.block_on(host.connect("lab/device/peer", "lab/peer/ctl")).unwrap();
    runtime.block_on(host.start("lab/peer")).unwrap();
    runtime.block_on(host.start("lab/device")).unwrap();
    eventually("one call of each kind", || {
        let reply = runtime.block_on(host.invoke("lab/device/ctl/answers", Value::Null));
        match serde_json::from_value::<[u64; 2]>(reply.unwrap().value.unwrap()).unwrap() {
            [blocked, done] if blocked > 0 && done > 0 => Ok(()),
            other => Err(format!("{other:?}")),
        }
    });
    runtime.block_on(host.shutdown());
}

#[test]
fn coordinates_of_ports_must_agree_and_both_ends_are_named_where_they_do_not() {
    let runtime = Runtime::new().unwrap();
    let host = host(&runtime);
    create(&runtime, &host, "retina", "retina");
    create(&runtime, &host, "robot", "robot");
    let connect = |client: &str, server: &str| {
        let (client, server) = (format!("lab/robot/{client}"), format!("lab/retina/{server}"));
        runtime.block_on(host.connect(&client, &server)).map_err(|e| e.to_string())
    };
    for (client, server, what) in [
        ("goal", "goal", "`position[…]`"),
        ("whole", "whole", "`pose.position[…]`"),
        ("aims", "tool", "argument of `aim`"),
        ("looks", "tool", "result of `measured_cp`"),
        ("told", "tool", "payload of event `touched`"),
    ] {
        let why = connect(client, server).unwrap_err();
        for part in [
            what,
            "is in frame robot here and frame retina there",
            &format!("lab/robot/{client}"),
            "lab/retina/",
        ] {
            assert!(why.contains(part), "{client}: {part:?} is not in: {why}");
        }
    }
    connect("open", "goal").unwrap();
    connect("same", "tool").unwrap();
    runtime.block_on(host.shutdown());
}

#[test]
fn the_coordinates_of_a_port_are_in_its_description_and_in_no_other() {
    let runtime = Runtime::new().unwrap();
    let host = host(&runtime);
    create(&runtime, &host, "robot", "robot");
    let robot = runtime.block_on(host.describe("lab/robot")).unwrap();
    let frames = |at: usize| match &robot.ports.inputs[at].ty {
        PortType::Plain(Type::Struct(s)) => {
            s.fields.iter().map(|f| (f.name.clone(), f.frame.clone())).collect::<Vec<_>>()
        }
        other => panic!("{other:?}"),
    };
    let pose = |frame: &str| {
        [("stamp", ""), ("position", frame), ("orientation", frame)].map(|(a, b)| (a.into(), b.into()))
    };
    assert_eq!((frames(0), frames(1)), (pose("robot").to_vec(), pose("").to_vec()));
    runtime.block_on(host.shutdown());
}

//! The components the plugin guide shows for ports that change, slices, services and untyped ports.
#![allow(clippy::unwrap_used)]

mod little_host;

/// Stands for the library of a device.
mod device {
    use trocar_sdk::data::Wrench;
    use trocar_sdk::prelude::*;

    pub(crate) fn wait_for_value() -> Wrench {
        std::thread::yield_now();
        Wrench { stamp: Stamp::from_ns(1), force: [0.0, 0.0, 0.5], ..Wrench::default() }
    }
}

trocar_sdk::testing::count_allocations!();

use little_host::LittleHost;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use trocar_sdk::data::{ImageHeader, PixelFormat, Pose, Wrench};
use trocar_sdk::serde_json::{Value, json};
use trocar_sdk::testing::Bench;
use trocar_sdk::{Place, ServiceReply, StaticPlugin, prelude::*, static_plugin};

#[derive(Config)]
struct ArmsCfg {
    /// Names of the arms.
    #[config(default = ["psm1", "psm2"])]
    arms: Vec<String>,
}

/// As many arms as are configured, each with a position, an interface and a robot behind it.
#[derive(Component)]
#[component(rate_hz = 500, provides("arm_{}"))]
struct Arms {
    #[input(name = "{}_position")]
    position: Many<In<f64>>,
    #[required(interface = "robot_{}")]
    servo_jp: Many<Function<f64>>,
    #[event("arm_{}")]
    reached: Many<Event<f64>>,
    #[names]
    arms: Names,
    #[state]
    goal: [f64; 8],
    #[config]
    cfg: ArmsCfg,
}

#[provides("arm_{}")]
impl Arms {
    #[command]
    fn move_jp(&mut self, arm: usize, #[arg(unit = "rad", min = -1.5, max = 1.5)] goal: f64) {
        self.goal[arm] = goal;
    }
    #[read]
    fn goal_jp(s: &ArmsState, arm: usize) -> f64 {
        s.goal[arm]
    }
}

impl Component for Arms {
    fn configure(&mut self) -> Result {
        if self.cfg.arms.len() > self.goal.len() {
            return Err(format!("arms: {} are too many, there is room for 8", self.cfg.arms.len()).into());
        }
        self.position.set(&self.cfg.arms)?;
        self.arms.set(&self.cfg.arms)
    }
    fn step(&mut self, _: &Tick) -> Result {
        for arm in 0..self.arms.len() {
            self.servo_jp[arm].send(self.goal[arm]);
            if self.position[arm].fresh() == Some(self.goal[arm]) {
                self.reached[arm].emit(self.goal[arm]);
            }
        }
        Ok(())
    }
}

/// Turns an image into its negative, on all threads of its stream.
#[derive(Component)]
#[component(model = "stream")]
struct Negative {
    #[input]
    image: In<Frame<ImageHeader>>,
    #[output]
    negative: Out<Frame<ImageHeader>>,
    #[host]
    host: Host,
}

impl Component for Negative {
    fn configure(&mut self) -> Result {
        self.negative.reserve(1920 * 1080 * 3, 4)
    }
    fn step(&mut self, _: &Tick) -> Result {
        let Some(image) = self.image.next() else { return Ok(()) };
        let Ok(from) = image.image() else { return Ok(()) }; // Its header promises more than its bytes hold.
        let row = from.row(0).len();
        let mut negative = self.negative.loan()?;
        *negative.header_mut() = ImageHeader { stride: row as u32, ..*image.header() };
        let bytes = row * from.height() as usize;
        let to = negative.bytes_mut().get_mut(..bytes).ok_or("the image is larger than 1080p")?;
        self.host.par_rows(to, row, |rows, part| {
            for (y, to) in rows.zip(part.chunks_mut(row)) {
                to.iter_mut().zip(from.row(y as u32)).for_each(|(to, from)| *to = 255 - *from);
            }
        })?;
        negative.commit(bytes, image.stamp());
        Ok(())
    }
}

/// Makes a source, and stops itself when that is refused.
#[derive(Component)]
struct Builder {
    #[host]
    host: Host,
    /// The token of what was asked for.
    making: Option<u64>,
}

impl Component for Builder {
    fn start(&mut self) -> Result {
        self.making = self.host.services().create("host/source", "sine", json!({"frequency_hz": 2.0})).ok();
        Ok(())
    }
    fn answered(&mut self, reply: ServiceReply) -> Result {
        if Some(reply.token) == self.making && !reply.ok {
            log::warn!("{}: {}", reply.reason, reply.message);
            let _ = self.host.services().stop(self.host.instance_name());
        }
        Ok(())
    }
}

/// Watches one number of whatever is connected.
#[derive(Component)]
struct Watch {
    #[input(optional)]
    any: AnyIn,
    #[state]
    value: f64,
    source: u64,
    place: Option<Place>,
}

impl Component for Watch {
    fn step(&mut self, _: &Tick) -> Result {
        let Some(sample) = self.any.latest() else { return Ok(()) };
        if sample.source() != self.source {
            self.source = sample.source();
            self.place = sample.place("position/2");
        }
        if let Some(place) = self.place {
            self.value = place.number(sample.value()).unwrap_or(f64::NAN);
        }
        Ok(())
    }
}

/// Follows a pose, and rests when none comes.
#[derive(Component)]
#[component(rate_hz = 1000, safety = "actuator", hardware)]
struct Gripper {
    #[input]
    goal: In<f64>,
    #[state]
    driven_to: f64,
}

impl Component for Gripper {
    fn step(&mut self, _: &Tick) -> Result {
        self.driven_to = self.goal.latest_or(0.0);
        Ok(())
    }
    fn make_safe(&mut self) -> Result {
        self.driven_to = 0.0;
        Ok(())
    }
}

/// A force sensor whose library calls back from a thread of its own.
#[derive(Component)]
#[component(model = "on_callback", safety = "sensor", hardware)]
struct Nano {
    #[output]
    wrench: Out<Wrench>,
    #[host]
    host: Host,
    open: Arc<AtomicBool>,
    device: Option<JoinHandle<Out<Wrench>>>,
}

impl Component for Nano {
    fn start(&mut self) -> Result {
        self.open.store(true, Ordering::Release);
        let (host, open, wrench) = (self.host.clone(), self.open.clone(), std::mem::take(&mut self.wrench));
        self.device = Some(std::thread::spawn(move || {
            while open.load(Ordering::Acquire) {
                let measured = device::wait_for_value();
                // Not active, or another callback is inside: this value is lost, the next one comes.
                let _lost = host.callback(|| wrench.write(&measured));
            }
            wrench
        }));
        Ok(())
    }
    fn stop(&mut self) -> Result {
        self.open.store(false, Ordering::Release);
        let Some(device) = self.device.take() else { return Ok(()) };
        self.wrench = device.join().map_err(|_| "the thread of the device panicked")?;
        Ok(())
    }
}

pub const CLASSES: StaticPlugin =
    static_plugin!(name = "guide", Arms, Negative, Builder, Watch, Gripper, Nano);

#[test]
fn arms_of_the_configuration_answer_each_for_itself() {
    let mut host = LittleHost::<Arms>::new();
    host.configure("{}").unwrap();
    host.describe_and_bind();
    host.start().unwrap();
    // move_jp and goal_jp of psm1, then of psm2.
    host.command(2, 0.25).unwrap();
    assert_eq!((host.read(1), host.read(3)), (Ok(0.0), Ok(0.25)));
    host.inputs[1].value = Some(0.25);
    host.step().unwrap();
    assert_eq!((host.events[0].written.len(), host.events[1].written.as_slice()), (0, &[0.25][..]));
    let many: Vec<String> = (0..9).map(|i| format!("arm{i}")).collect();
    let refused = host.configure(&json!({"arms": many}).to_string()).unwrap_err().1;
    assert!(refused.contains("9 are too many"), "{refused}");
}

#[test]
fn the_builder_asks_and_gives_up_when_it_is_refused() {
    let mut host = LittleHost::<Builder>::new();
    host.start().unwrap();
    let (token, asked) = host.asked.services[0].clone();
    assert_eq!(serde_json::from_str::<Value>(&asked).unwrap()["verb"], "Create");
    assert_eq!(
        host.reply(token, r#"{"ok": false, "reason": "CLASS_NOT_FOUND", "message": "no class sine"}"#),
        0
    );
    assert!(host.asked.services[1].1.contains(r#""verb":"Stop""#));
}

#[test]
fn each_example_is_a_class_of_the_plugin() {
    let manifest = trocar_plugin_api::manifest::Manifest::parse(CLASSES.manifest.as_bytes()).unwrap();
    let names: Vec<&str> = manifest.classes.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["arms", "negative", "builder", "watch", "gripper", "nano"]);
    let mut negative = Bench::<Negative>::new("{}");
    let header =
        ImageHeader { width: 2, height: 2, stride: 3, format: PixelFormat::GRAY8, ..ImageHeader::default() };
    negative.push_frame("image", header, &[0, 255, 99, 1, 254]);
    negative.step(1);
    let (made, bytes, _) = negative.frames::<ImageHeader>("negative").remove(0);
    assert_eq!((made.stride, bytes.as_slice()), (2, &[255, 0, 254, 1][..]));
    let lie = ImageHeader { height: u32::MAX, ..header };
    negative.push_frame("image", lie, &[0; 5]);
    negative.step(1);
    assert!(negative.frames::<ImageHeader>("negative").is_empty(), "a frame without what its header says");
}

#[test]
fn any_pose_is_watched() {
    let mut bench = Bench::<Watch>::new("{}");
    bench.push("any", Pose { position: [0.0, 0.0, 0.25], ..Pose::default() });
    bench.step(1);
    assert_eq!(bench.state().value, 0.25);
    bench.push("any", Wrench::default());
    bench.step(1);
    assert_eq!(bench.state().value, 0.25, "a wrench has no position");
}

#[test]
fn a_gripper_rests_on_an_old_goal_and_allocates_nothing() {
    let mut bench = Bench::<Gripper>::new("{}");
    bench.assert_no_alloc(|bench| {
        bench.push("goal", 0.8);
        bench.step(1);
    });
    assert_eq!(bench.state().driven_to, 0.8);
    bench.make_stale("goal");
    bench.step(1);
    assert_eq!(bench.state().driven_to, 0.0);
    bench.push("goal", 0.8);
    bench.step(1);
    bench.stop().unwrap();
    assert_eq!((bench.made_safe(), bench.state().driven_to), (1, 0.0));
}

#[test]
fn an_unconnected_gripper_rests() {
    let mut bench = Bench::<Gripper>::new("{}");
    bench.push("goal", 0.8);
    bench.connect_input("goal", false);
    bench.step(1);
    assert_eq!(bench.state().driven_to, 0.0);
}

#[test]
fn the_values_of_a_device_come_out_and_it_can_be_started_again() {
    let mut bench = Bench::<Nano>::new("{}");
    for _ in 0..2 {
        let before = bench.callbacks().0;
        while bench.callbacks().0 == before {
            std::thread::yield_now();
        }
        bench.stop().unwrap();
        assert_eq!(bench.outputs::<Wrench>("wrench")[0].force[2], 0.5);
        bench.start().unwrap();
    }
    bench.stop().unwrap();
}

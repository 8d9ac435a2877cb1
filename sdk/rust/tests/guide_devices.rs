//! The components the plugin guide shows for devices: what is safe from any thread, and coordinates of ports.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use trocar_plugin_api::manifest::Manifest;
use trocar_sdk::data::{ImageHeader, Pose};
use trocar_sdk::testing::Bench;
use trocar_sdk::{StaticPlugin, prelude::*, static_plugin};

/// What stops the motor: shared by the component and whoever makes it safe.
#[derive(Default)]
struct Brake {
    closed: AtomicBool,
}

impl MakeSafe for Brake {
    fn make_safe(&self) -> Result {
        self.closed.store(true, Ordering::Release);
        Ok(())
    }
}

/// Turns unless its brake is closed.
#[derive(Component)]
#[component(rate_hz = 1000, safety = "actuator", safe_from_any_thread)]
struct Motor {
    brake: Arc<Brake>,
    #[state]
    turns: u64,
}

impl SafeFromAnyThread for Motor {
    fn safe_handle(&self) -> Arc<dyn MakeSafe> {
        self.brake.clone()
    }
}

impl Component for Motor {
    fn start(&mut self) -> Result {
        self.brake.closed.store(false, Ordering::Release);
        Ok(())
    }
    fn step(&mut self, _: &Tick) -> Result {
        self.turns += u64::from(!self.brake.closed.load(Ordering::Acquire));
        Ok(())
    }
}

/// Leads a tool to a goal on the retina.
#[derive(Component)]
#[component(rate_hz = 500, provides("tool"))]
struct Guide {
    #[input(optional)]
    #[frame("retina")]
    goal: In<Pose>,
    #[required(interface = "robot", optional)]
    #[frame("robot")]
    servo_cp: Function<Pose>,
    #[event("tool")]
    #[frame("retina")]
    reached: Event<Pose>,
    #[state]
    #[frame("retina")]
    tip: Pose,
}

#[provides("tool")]
impl Guide {
    #[command]
    fn aim(&mut self, #[frame("retina")] goal: Pose) {
        self.tip = goal;
    }
    #[read]
    #[frame("retina")]
    fn measured_cp(s: &GuideState) -> Pose {
        s.tip
    }
}

impl Component for Guide {
    fn step(&mut self, _: &Tick) -> Result {
        if let Some(goal) = self.goal.fresh() {
            self.tip = goal;
            self.reached.emit(goal);
            self.servo_cp.send(goal);
        }
        Ok(())
    }
}

/// Inverts images without copying them, where it can.
#[derive(Component)]
#[component(model = "stream", rate_hz = 30)]
struct InPlace {
    #[input]
    image: In<Frame<ImageHeader>>,
    #[output]
    inverted: Out<Frame<ImageHeader>>,
    #[state]
    shared: u64,
}

impl Component for InPlace {
    fn step(&mut self, _: &Tick) -> Result {
        let Some(mut image) = self.image.next() else { return Ok(()) };
        match image.bytes_mut() {
            Some(bytes) => bytes.iter_mut().for_each(|b| *b = 255 - *b),
            // Somebody else reads it, too: it passes as it is.
            None => self.shared += 1,
        }
        self.inverted.forward(&image);
        self.image.release();
        Ok(())
    }
}

const CLASSES: StaticPlugin = static_plugin!(name = "guide", Motor, Guide, InPlace);

#[test]
fn a_motor_turns_until_its_brake_is_closed_and_again_after_a_fresh_start() {
    let mut bench = Bench::<Motor>::new("{}");
    bench.step(3);
    bench.make_safe().unwrap();
    bench.step(3);
    assert_eq!(bench.state().turns, 3);
    bench.stop().unwrap();
    bench.start().unwrap();
    bench.step(1);
    assert_eq!(bench.state().turns, 4);
}

#[test]
fn every_port_says_in_which_coordinates_it_is() {
    let manifest = Manifest::parse(CLASSES.manifest.as_bytes()).unwrap();
    let guide = &manifest.classes[1];
    let (tool, robot) = (&guide.provided[0], &guide.required[0]);
    let [aim, measured_cp] = tool.commands.as_slice() else { panic!("{:?}", tool.commands) };
    assert_eq!((guide.inputs[0].frame.as_str(), robot.functions[0].frame.as_str()), ("retina", "robot"));
    assert_eq!((aim.arg.as_ref().unwrap().frame.as_str(), aim.ret_frame.as_str()), ("retina", ""));
    assert_eq!((measured_cp.ret_frame.as_str(), tool.events[0].frame.as_str()), ("retina", "retina"));
    let row = manifest.named("GuideState").unwrap();
    assert_eq!((row.fields[0].name.as_str(), row.fields[0].frame.as_str()), ("tip", "retina"));
    let pose = manifest.named("Pose").unwrap();
    assert!(pose.fields.iter().all(|f| f.frame.is_empty()), "the payload itself is everybody's");
}

#[test]
fn a_guide_leads_what_it_is_told_to() {
    let mut bench = Bench::<Guide>::new("{}");
    let goal = Pose { position: [0.0, 0.0, 0.01], ..Pose::default() };
    bench.push("goal", goal);
    bench.step(1);
    assert_eq!(bench.calls::<Pose>("robot/servo_cp"), [goal]);
    assert_eq!(bench.events::<Pose>("tool/reached"), [goal]);
    bench.command::<Pose, ()>("aim", Pose::default()).unwrap();
    assert_eq!(bench.read::<(), Pose>("measured_cp", ()).unwrap(), Pose::default());
}

#[test]
fn an_image_is_inverted_where_it_lies() {
    let mut bench = Bench::<InPlace>::new("{}");
    bench.push_frame("image", ImageHeader::default(), &[0, 255, 1]);
    bench.step(1);
    assert_eq!(bench.frames::<ImageHeader>("inverted")[0].1, [255, 0, 254]);
    assert_eq!(bench.state().shared, 0);
}

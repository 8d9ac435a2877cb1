//! The component the plugin guide shows for names, units and optional members, and how a test talks to each
//! of them.
#![allow(clippy::unwrap_used)]

use trocar_plugin_api::manifest::Manifest;
use trocar_sdk::testing::Bench;
use trocar_sdk::{StaticPlugin, prelude::*, static_plugin};

/// Moves the right arm as the left one is moved, scaled.
#[derive(Component)]
#[component(rate_hz = 100, optional("light"))]
struct Mirror {
    /// Both arms call it `measured_jp` and `servo_jp`: `name` says so, the field is called otherwise.
    #[required(interface = "left", name = "measured_jp")]
    left: Function<(), f64>,
    #[required(interface = "right", name = "servo_jp", unit = "rad")]
    right: Function<f64>,
    /// An arm without this command will do, too.
    #[required(interface = "right", optional)]
    hold: Function,
    /// Need not be connected; what is connected has this command.
    #[required(interface = "light", name = "set")]
    light: Function<Flag>,
    #[output]
    copy: Out<f64>,
    #[event("control", unit = "rad")]
    moved: Event<f64>,
    #[state]
    #[unit("rad")]
    sent: f64,
    gain: f64,
}

#[provides("control")]
impl Mirror {
    #[command]
    fn set_gain(&mut self, #[arg(unit = "1", min = 0, max = 10)] gain: f64) {
        self.gain = gain;
    }
    #[read(unit = "rad")]
    fn sent(s: &MirrorState) -> f64 {
        s.sent
    }
}

#[handles("right")]
impl Mirror {
    #[on(optional)]
    fn touched(&mut self, force: f64) {
        self.gain = 0.0;
        log::info!("touched with {force} N");
    }
}

impl Component for Mirror {
    fn step(&mut self, _: &Tick) -> Result {
        let Ok(joint) = self.left.call(()) else {
            self.hold.send(());
            return Ok(());
        };
        self.sent = self.gain * joint;
        self.right.send(self.sent);
        self.light.send(Flag::from(self.sent != 0.0));
        self.copy.write(&self.sent);
        self.moved.emit(self.sent);
        Ok(())
    }
}

const CLASSES: StaticPlugin = static_plugin!(name = "guide", Mirror);

#[test]
fn the_right_arm_follows_the_left_one() {
    let mut bench = Bench::<Mirror>::new("{}");
    // The peer of a function: what it answers, or why it does not.
    bench.answer("left/measured_jp", |()| Ok(0.5));
    // A command of the component itself: types of argument and result, name, argument.
    bench.command::<f64, ()>("control/set_gain", 2.0).unwrap();
    assert!(bench.command::<f64, ()>("control/set_gain", 11.0).is_err());
    bench.step(1);
    // Everything since the last asking, in its order.
    assert_eq!(bench.outputs::<f64>("copy"), [1.0]);
    assert_eq!(bench.events::<f64>("control/moved"), [1.0]);
    assert_eq!(bench.calls::<f64>("right/servo_jp"), [1.0]);
    assert_eq!(bench.read::<(), f64>("control/sent", ()).unwrap(), 1.0);
    // An event of the peer: the handler runs.
    bench.emit("right/touched", 0.1).unwrap();
    bench.step(1);
    assert_eq!(bench.calls::<f64>("right/servo_jp"), [0.0]);
    bench.answer("left/measured_jp", |()| Err::<f64, _>("it is switched off".into()));
    bench.step(1);
    assert_eq!(bench.calls::<()>("right/hold").len(), 1);
}

#[test]
fn names_units_and_what_is_optional_stand_in_the_manifest() {
    let manifest = Manifest::parse(CLASSES.manifest.as_bytes()).unwrap();
    let class = &manifest.classes[0];
    let [left, right, light] = class.required.as_slice() else { panic!("{:?}", class.required) };
    assert_eq!((left.optional, right.optional, light.optional), (false, false, true));
    assert_eq!((left.functions[0].name.as_str(), light.functions[0].name.as_str()), ("measured_jp", "set"));
    assert_eq!((right.functions[0].optional, right.functions[1].optional), (false, true));
    assert!(right.handlers[0].optional && !light.functions[0].optional);
    let control = &class.provided[0];
    let [set_gain, sent] = control.commands.as_slice() else { panic!("{:?}", control.commands) };
    assert_eq!((right.functions[0].unit.as_str(), control.events[0].unit.as_str()), ("rad", "rad"));
    assert_eq!((set_gain.arg.as_ref().unwrap().unit.as_str(), sent.ret_unit.as_str()), ("1", "rad"));
    assert_eq!(manifest.named("MirrorState").unwrap().fields[0].unit, "rad");
}

//! Things that safe code may do with parts of a component: keep them beyond its end, or exchange its lists.
//! The host is asked to keep the parts that are still held, and only those; a command never becomes another
//! list's.
#![allow(clippy::unwrap_used)]

mod little_host;

use std::any::Any;
use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};

use little_host::LittleHost;
use trocar_sdk::prelude::*;

type Left = Box<dyn Any + Send>;

/// Hands out its own parts as it is told to, for the test to hold.
#[derive(Component)]
#[component(model = "none", provides("ctl"), requires("peer"))]
struct Holder {
    #[input]
    x: In<f64>,
    #[output]
    y: Out<f64>,
    #[input(name = "{}_q")]
    q: Many<In<f64>>,
    #[required(interface = "peer")]
    ask: Function<f64, f64>,
    #[event("ctl")]
    over: Event<f64>,
    #[host]
    host: Host,
    #[config]
    cfg: Cfg,
}

#[derive(Config)]
struct Cfg {
    #[config(default = "")]
    keeps: String,
    #[config(default = ["a", "b"])]
    q: Vec<String>,
}

/// Handles that the testing thread holds beyond a component.
static HELD: Mutex<Vec<Left>> = Mutex::new(Vec::new());
/// Tests take turns, for there is one list.
static TURN: Mutex<()> = Mutex::new(());

fn held() -> std::sync::MutexGuard<'static, Vec<Left>> {
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

#[provides("ctl")]
impl Holder {}

impl Component for Holder {
    fn configure(&mut self) -> Result {
        self.q.set(&self.cfg.q)
    }
    fn start(&mut self) -> Result {
        let out: Left = match self.cfg.keeps.as_str() {
            "x" => Box::new(core::mem::take(&mut self.x)),
            "y" => Box::new(core::mem::take(&mut self.y)),
            "q" => Box::new(core::mem::take(&mut self.q)),
            "ask" => Box::new(core::mem::take(&mut self.ask)),
            "over" => Box::new(core::mem::take(&mut self.over)),
            "host" => Box::new(self.host.clone()),
            _ => return Ok(()),
        };
        held().push(out);
        Ok(())
    }
}

fn holder(keeps: &str) -> Box<LittleHost<Holder>> {
    let mut host = LittleHost::new();
    host.configure(&format!(r#"{{"keeps": "{keeps}"}}"#)).unwrap();
    host.describe_and_bind();
    host.start().unwrap();
    host
}

#[test]
fn the_host_is_asked_to_keep_what_is_still_held_when_a_component_ends() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    for keeps in ["x", "y", "q", "ask", "over", "host"] {
        let host = holder(keeps);
        let kept = host.asked.kept.clone();
        assert_eq!(kept.load(Ordering::SeqCst), 0, "{keeps}: it lives");
        drop(host);
        assert_eq!(kept.load(Ordering::SeqCst), 1, "{keeps}");
        held().clear();
    }
}

#[test]
fn nothing_is_kept_when_nothing_is_held() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    for keeps in ["", "y", "q", "host"] {
        let host = holder(keeps);
        let kept = host.asked.kept.clone();
        held().clear();
        drop(host);
        assert_eq!(kept.load(Ordering::SeqCst), 0, "{keeps:?}: given back before its end");
    }
}

#[test]
fn a_port_that_is_held_while_its_component_is_bound_anew_is_kept_at_once() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    for (keeps, times) in [("q", 1), ("x", 1), ("host", 0), ("", 0)] {
        let mut host = holder(keeps);
        host.configure(r#"{"q": ["b"]}"#).unwrap();
        host.describe_and_bind();
        assert_eq!(host.asked.kept.load(Ordering::SeqCst), times, "{keeps:?}");
        held().clear();
    }
}

#[derive(Payload, Clone, Copy)]
#[repr(C)]
struct Big {
    v: [f64; 64],
}

/// Two lists, whose commands take arguments of two sizes; the fate of the lists is a setting.
#[derive(Component)]
#[component(model = "none", provides("arm_{}", "tool_{}"), requires("robot_{}"))]
struct Lists {
    #[names("arm_{}", "robot_{}")]
    arms: Names,
    #[names("tool_{}")]
    tools: Names,
    #[state]
    seen: f64,
    #[state]
    told: u32,
    #[config]
    cfg: Became,
}

#[derive(Config)]
struct Became {
    #[config(default = "")]
    became: String,
}

#[provides("arm_{}")]
impl Lists {
    #[command]
    fn set(&mut self, arm: usize, value: f64) -> f64 {
        self.seen = value + 10.0 * arm as f64;
        self.seen
    }
}

#[provides("tool_{}")]
impl Lists {
    #[command(name = "set")]
    fn set_big(&mut self, _tool: usize, big: &Big) -> f64 {
        self.seen = 99.0 + big.v[63];
        self.seen
    }
}

#[handles("robot_{}")]
impl Lists {
    #[on]
    fn stopped(&mut self, arm: usize, why: u32) {
        self.told = 100 * (arm as u32 + 1) + why;
    }
}

impl Component for Lists {
    fn configure(&mut self) -> Result {
        self.arms.set(["a", "b"])?;
        self.tools.set(["a"])
    }
    fn start(&mut self) -> Result {
        match self.cfg.became.as_str() {
            "empty" => self.arms = Names::default(),
            "swapped" => core::mem::swap(&mut self.arms, &mut self.tools),
            "cloned" => self.tools = self.arms.clone(),
            _ => self.arms.set(["z"])?,
        }
        Ok(())
    }
}

#[test]
fn a_command_means_what_the_host_was_told_whatever_became_of_the_lists() {
    for became in ["empty", "swapped", "cloned", "set"] {
        let mut host = LittleHost::<Lists>::new();
        host.configure(&format!(r#"{{"became": "{became}"}}"#)).unwrap();
        host.describe_and_bind();
        host.start().unwrap();
        assert_eq!(host.command(0, 5.0), Ok(5.0), "{became}: arm_a/set");
        assert_eq!(host.command(1, 5.0), Ok(15.0), "{became}: arm_b/set");
        host.on_event(1, 3).unwrap();
        assert_eq!(host.state().told, 203, "{became}: robot_b/stopped");
        assert!(host.command(3, 5.0).is_err(), "{became}: there are three");
        // After another description the lists have their present state.
        host.describe_and_bind();
    }
}

//! `watchdog`: lost, found, and hold.

use super::*;

#[test]
fn lost_data_are_told_once_with_their_age_and_the_device_holds() {
    let mut bench = Bench::<Watchdog>::new(r#"{"timeout_s": 0.02}"#);
    for _ in 0..10 {
        bench.push("watched", scalar(1.0));
        bench.step(1);
    }
    bench.step(100);
    assert_eq!(bench.calls::<()>("device/hold").len(), 1);
    let lost = bench.events::<f64>("ctl/lost");
    assert_eq!(lost.len(), 1);
    assert!(lost[0] > 0.02 && lost[0] < 0.0225, "{lost:?}");
    assert!(!bench.read::<(), Flag>("alive", ()).unwrap().get());
    bench.push("watched", scalar(2.0));
    bench.step(1);
    let found = bench.events::<f64>("ctl/found");
    assert!(found.len() == 1 && (found[0] - 0.08).abs() < 0.003, "{found:?}");
    assert_eq!(bench.state().losses, 1);
}

#[test]
fn data_that_never_come_are_lost_and_so_are_those_that_repeat_an_old_stamp() {
    let mut bench = Bench::<Watchdog>::new("{}");
    bench.step(100);
    assert_eq!(bench.events::<f64>("ctl/lost").len(), 1);
    bench.push("watched", Wrench::default());
    bench.step(1);
    let old = bench.now();
    for _ in 0..100 {
        bench.push_at("watched", Wrench::default(), old);
        bench.step(1);
    }
    assert_eq!(bench.events::<f64>("ctl/lost").len(), 1, "a source that hangs but sends is lost, too");
    assert!(refused::<Watchdog>(r#"{"timeout_s": 0}"#).starts_with("timeout_s: 0 s is below"));
}

#[test]
fn the_device_is_told_to_hold_again_and_again_while_data_are_lost() {
    let mut bench = Bench::<Watchdog>::new(r#"{"timeout_s": 0.02, "repeat_s": 0.1}"#);
    bench.connect_function("device/hold", false);
    bench.push("watched", scalar(1.0));
    bench.step(60);
    bench.connect_function("device/hold", true);
    bench.step(500);
    let (heard, said) = (bench.calls::<()>("device/hold").len(), bench.state().holds);
    assert_eq!((heard, said), (5, 6), "one that came later hears it, too");
    assert_eq!((bench.events::<f64>("ctl/lost").len(), bench.state().losses), (1, 1));
    bench.push("watched", scalar(1.0));
    bench.step(10);
    assert!(bench.calls::<()>("device/hold").is_empty(), "not while data come");
}

#[test]
fn data_are_alive_after_the_first_sample_and_not_before() {
    let mut bench = Bench::<Watchdog>::new("{}");
    let alive = |bench: &mut Bench<Watchdog>, steps: u64| {
        bench.step(steps);
        (bench.state().alive.get(), bench.state().data_lost.get())
    };
    assert_eq!(alive(&mut bench, 10), (false, false), "waited for");
    bench.push("watched", scalar(1.0));
    assert_eq!(alive(&mut bench, 1), (true, false));
    assert_eq!(alive(&mut bench, 60), (false, true));
    bench.stop().unwrap();
    bench.push("watched", scalar(1.0));
    bench.advance(100_000_000);
    bench.resume().unwrap();
    assert_eq!(alive(&mut bench, 10), (false, false), "what came before says nothing");
    assert_eq!(alive(&mut bench, 60), (false, true));
}

#[test]
fn a_stamp_from_ahead_does_not_keep_a_dead_source_alive() {
    let mut bench = Bench::<Watchdog>::new("{}");
    bench.push("watched", scalar(1.0));
    bench.step(1);
    for ahead in [u64::MAX, u64::MAX / 2, bench.now().ns() + 100_000_000] {
        bench.push("watched", Scalar { stamp: Stamp::from_ns(ahead), value: 1.0 });
        bench.step(60);
        assert!(bench.state().data_lost.get(), "{ahead}");
    }
}

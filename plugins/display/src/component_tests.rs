//! The display on the bench: what it counts, and what it refuses.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::data::PixelFormat;
use trocar_sdk::testing::Bench;

trocar_sdk::testing::count_allocations!();

/// Two images of `width` × 16 px.
fn header(index: u64, width: u32) -> StereoHeader {
    let stride = 3 * width;
    let right_offset = u64::from(stride) * 16;
    StereoHeader {
        index,
        width,
        height: 16,
        stride,
        format: PixelFormat::RGB8,
        right_offset,
        ..Default::default()
    }
}

#[test]
fn it_counts_frames_and_knows_their_age() {
    let mut bench = Bench::<Display>::new("{}");
    bench.push_frame("image", header(1, 2), &[0; 192]);
    bench.advance(4_000_000);
    bench.step(1);
    let s = bench.state();
    assert_eq!((s.frames, s.gaps, s.width, s.height), (1, 0, 2, 16));
    // 4 ms, and the bench's step of 1 ms.
    assert!((s.latency_ms - 5.0).abs() < 1e-9, "{} ms", s.latency_ms);
    assert_eq!(bench.read::<(), u64>("frames", ()).unwrap(), 1);
}

#[test]
fn it_counts_what_was_overwritten_before_it_was_shown() {
    let mut bench = Bench::<Display>::new("{}");
    for index in 0..4 {
        bench.push_frame("image", header(index, 1), &[0; 96]);
        if index != 1 && index != 2 {
            bench.step(1);
        }
    }
    assert_eq!((bench.state().frames, bench.state().gaps), (2, 2));
}

#[test]
fn it_tells_percentiles_of_the_ages_until_it_is_told_to_forget_them() {
    let mut bench = Bench::<Display>::new("{}");
    for n in 0..100 {
        bench.push_frame("image", header(n, 1), &[0; 96]);
        bench.advance(if n == 50 { 40_000_000 } else { 3_000_000 });
        bench.step(1);
    }
    let told: Latency = bench.read("latency", ()).unwrap();
    assert_eq!(told.frames, 100);
    assert!((told.p50_ms - 4.0).abs() < 0.15 && (told.p99_ms - 4.0).abs() < 0.15, "{told:?}");
    assert!((told.max_ms - 41.0).abs() < 1e-6, "{told:?}");
    bench.command::<(), ()>("reset_latency", ()).unwrap();
    assert_eq!(bench.read::<(), Latency>("latency", ()).unwrap(), Latency::default());
}

#[test]
fn a_frame_that_came_after_the_one_before_was_stale_is_a_stall() {
    let mut bench = Bench::<Display>::new("{}");
    let show = |bench: &mut Bench<Display>, ahead_ns: u64| {
        let stamp = Stamp::from_ns(bench.now().ns() + ahead_ns);
        bench.push_frame("image", StereoHeader { stamp, ..header(1, 2) }, &[0; 192]);
        bench.step(1);
        bench.state().stalls
    };
    assert_eq!(show(&mut bench, 0), 0);
    bench.advance(400_000_000);
    assert_eq!(show(&mut bench, 0), 0);
    bench.advance(700_000_000);
    assert_eq!(bench.state().stalls, 0, "it is not over");
    assert_eq!(show(&mut bench, 0), 1);
    // A camera whose clock is a minute ahead, and that falls silent, is silent.
    assert_eq!(show(&mut bench, 60_000_000_000), 1);
    bench.advance(700_000_000);
    assert_eq!(show(&mut bench, 0), 2);
    // What comes now and then never becomes stale.
    bench.configure(r#"{"stale_after_s": 0}"#).unwrap();
    bench.advance(90_000_000_000);
    assert_eq!(show(&mut bench, 0), 2);
}

#[test]
fn single_images_are_counted_as_pairs_are() {
    let mut bench = Bench::<Display>::new("{}");
    let picture =
        ImageHeader { width: 16, height: 16, stride: 16, format: PixelFormat::GRAY8, ..Default::default() };
    for _ in 0..3 {
        bench.push_frame("picture", picture, &[90; 256]);
        bench.step(1);
    }
    let s = bench.state();
    assert_eq!((s.width, s.height, s.frames, s.gaps), (16, 16, 3, 0));
    assert_eq!(s.frames, s.latency.frames);
}

#[test]
fn a_step_allocates_nothing() {
    let mut bench = Bench::<Display>::new("{}");
    let show = |bench: &mut Bench<Display>, index: u64| {
        bench.push_frame("image", header(index, 16), &[7; 2 * 3 * 16 * 16]);
        bench.step(1);
    };
    (0..50).for_each(|index| show(&mut bench, index));
    bench.assert_no_alloc(|bench| (0..200).for_each(|index| show(bench, index)));
}

/// Gives each frame away in its step, as the display does to its window.
#[derive(Component)]
#[component(model = "on_signal")]
struct Giving {
    #[input]
    image: In<Frame<StereoHeader>>,
    #[state]
    given: u64,
    ends: Option<(Giver, crate::handoff::Taker)>,
}

impl Component for Giving {
    fn start(&mut self) -> Result {
        self.ends = Some(crate::handoff::pair(2 * 3 * 16 * 16));
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        while let (Some(frame), Some((giver, _))) = (self.image.next(), &mut self.ends) {
            self.given += u64::from(giver.give(frame.header(), frame.bytes()));
        }
        Ok(())
    }
}

#[test]
fn a_frame_for_the_window_is_copied_without_an_allocation() {
    let mut bench = Bench::<Giving>::new("{}");
    let show = |bench: &mut Bench<Giving>, index: u64| {
        bench.push_frame("image", header(index, 16), &[7; 2 * 3 * 16 * 16]);
        bench.step(1);
    };
    (0..50).for_each(|index| show(&mut bench, index));
    bench.assert_no_alloc(|bench| (0..200).for_each(|index| show(bench, index)));
    assert_eq!(bench.state().given, 250);
}

#[test]
fn frames_whose_header_lies_are_counted() {
    let mut bench = Bench::<Display>::new(r#"{"max_width": 8, "max_height": 8}"#);
    for index in 0..20 {
        bench.push_frame("image", StereoHeader { width: 999, ..header(index, 2) }, &[0; 192]);
        bench.step(1);
    }
    assert_eq!((bench.state().frames, bench.state().gaps), (20, 0));
}

#[test]
fn a_window_without_a_display_is_refused_with_what_is_missing() {
    let mut bench = Bench::<Display>::ready(r#"{"window": true}"#);
    match bench.start() {
        Err(why) => {
            assert!(why.reason.starts_with("window: ") && why.reason.contains("open /video"), "{why}")
        }
        // A machine with a display has a window.
        Ok(()) => assert!(bench.state().window_open.get()),
    }
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    let refused = |config: &str| Bench::<Display>::created().configure(config).unwrap_err().reason;
    assert_eq!(refused(r#"{"stale_after_s": -1}"#), "stale_after_s: -1 s is below 0 s");
    assert!(
        refused(r#"{"mjpeg_port": 0}"#).contains("mjpeg_port"),
        "a port of its own is no setting any more"
    );
}

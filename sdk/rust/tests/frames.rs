//! Frames and queues: loans, views, forwarding, staleness.
#![allow(clippy::unwrap_used)]
#![forbid(unsafe_code)]

use trocar_sdk::data::{ImageHeader, PixelFormat};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

/// Inverts an image: in place when it may, else into a new frame.
#[derive(Component)]
#[component(model = "stream")]
struct Invert {
    #[input]
    image: In<Frame<ImageHeader>>,
    #[input(fifo = 3, optional)]
    numbers: In<u32>,
    #[output]
    copied: Out<Frame<ImageHeader>>,
    #[output]
    in_place: Out<Frame<ImageHeader>>,
    #[state]
    sum: u32,
    #[state]
    gaps: u64,
    #[state]
    stale: Flag,
    last_seq: u64,
}

impl Component for Invert {
    fn configure(&mut self) -> Result {
        self.copied.reserve(64, 4)
    }
    fn step(&mut self, _: &Tick) -> Result {
        while let Some(s) = self.numbers.next_sample() {
            self.sum += s.value;
            self.gaps += s.seq - self.last_seq - 1;
            self.last_seq = s.seq;
        }
        let Some(mut view) = self.image.latest() else { return Ok(()) };
        self.stale = view.is_stale().into();
        if !view.is_fresh() {
            return Ok(());
        }
        let mut loan = self.copied.loan()?;
        *loan.header_mut() = *view.header();
        let len = view.bytes().len();
        for (to, from) in loan.bytes_mut().iter_mut().zip(view.bytes()) {
            *to = !from;
        }
        loan.commit(len, view.stamp());
        if let Some(bytes) = view.bytes_mut() {
            bytes.iter_mut().for_each(|b| *b = !*b);
        }
        self.in_place.forward(&view);
        Ok(())
    }
}

fn header(index: u64) -> ImageHeader {
    ImageHeader { index, width: 2, height: 1, stride: 2, format: PixelFormat::GRAY8, ..Default::default() }
}

#[test]
fn a_frame_is_copied_into_a_loan_and_forwarded_in_place() {
    let mut bench = Bench::<Invert>::new("{}");
    bench.push_frame("image", header(7), &[0, 0x0f]);
    let pushed_at = bench.now();
    bench.step(2);
    for output in ["copied", "in_place"] {
        let frames = bench.frames::<ImageHeader>(output);
        assert_eq!(frames, [(header(7), vec![0xff, 0xf0], pushed_at)], "output {output}");
    }
}

#[test]
fn a_loan_that_is_not_to_be_had_is_no_fault() {
    let mut bench = Bench::<Invert>::new("{}");
    bench.exhaust("copied", true);
    bench.push_frame("image", header(0), &[0]);
    bench.step(1);
    assert!(bench.frames::<ImageHeader>("in_place").is_empty());
}

#[test]
fn a_stale_frame_says_so_until_a_new_one_comes() {
    let mut bench = Bench::<Invert>::new("{}");
    bench.push_frame("image", header(0), &[0]);
    bench.make_stale("image");
    bench.step(1);
    assert!(bench.state().stale.get());
    bench.push_frame("image", header(1), &[0]);
    bench.step(1);
    assert!(!bench.state().stale.get());
}

#[test]
fn a_queue_gives_each_sample_once_and_a_gap_tells_what_was_dropped() {
    let mut bench = Bench::<Invert>::new("{}");
    for n in 1..=5u32 {
        bench.push("numbers", n);
    }
    bench.step(1);
    assert_eq!((bench.state().sum, bench.state().gaps), (3 + 4 + 5, 2));
    bench.step(1);
    assert_eq!(bench.state().sum, 12);
}

#[test]
fn a_cut_input_gives_nothing() {
    let mut bench = Bench::<Invert>::new("{}");
    bench.push_frame("image", header(0), &[0]);
    bench.connect_input("image", false);
    bench.step(1);
    assert!(bench.frames::<ImageHeader>("copied").is_empty());
}

#[test]
fn a_restored_instance_goes_on_from_the_state_of_the_former() {
    let mut old = Bench::<Invert>::new("{}");
    old.push("numbers", 5u32);
    old.step(1);
    let (state, extra) = old.snapshot();
    assert!(extra.is_empty());
    let mut new = Bench::<Invert>::new("{}");
    new.restore(&state, &extra).unwrap();
    assert_eq!(new.state().sum, 5);
    let refused = new.restore(&state[1..], &[]).unwrap_err();
    assert_eq!(refused.reason, "the state block has 23 bytes, this class's has 24");
}

#[test]
#[should_panic(expected = "plain samples go in with `push`, frames with `push_frame`")]
fn the_bench_tells_samples_from_frames() {
    Bench::<Invert>::new("{}").push("image", header(0));
}

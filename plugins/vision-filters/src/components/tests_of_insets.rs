//! `pip` on the bench: where its inset goes, where it comes from, and what it costs.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::Flag;
use trocar_sdk::data::{ImageHeader, PixelFormat, StereoHeader};
use trocar_sdk::testing::Bench;

/// Two images with touching rows.
fn header(width: u32, height: u32, format: PixelFormat) -> StereoHeader {
    let right_offset = u64::from(width * height) * format.bytes_per_pixel() as u64;
    StereoHeader { right_offset, ..StereoHeader::from(picture(width, height, format)) }
}

/// One image with touching rows.
fn picture(width: u32, height: u32, format: PixelFormat) -> ImageHeader {
    let stride = width * format.bytes_per_pixel() as u32;
    ImageHeader { index: 1, width, height, stride, format, ..Default::default() }
}

/// Frames that came out.
fn out(bench: &mut Bench<Pip>) -> Vec<(StereoHeader, Vec<u8>)> {
    bench.frames::<StereoHeader>("composed").into_iter().map(|(h, bytes, _)| (h, bytes)).collect()
}

fn filtered(bench: &mut Bench<Pip>, header: StereoHeader, bytes: &[u8]) -> Vec<(StereoHeader, Vec<u8>)> {
    bench.push_frame("image", header, bytes);
    bench.step(1);
    out(bench)
}

/// The bytes that come out for a black pair of 4 × 2 px.
fn over_black(bench: &mut Bench<Pip>) -> Vec<u8> {
    filtered(bench, header(4, 2, PixelFormat::GRAY8), &[0; 16]).remove(0).1
}

fn set_rect(bench: &mut Bench<Pip>, w: u32, h: u32) {
    let rect = PipRect { x: 0, y: 0, w, h, alpha: 1.0 };
    bench.command::<PipRect, ()>("inset_control/set_rect", rect).unwrap();
}

#[test]
fn pip_lays_the_newest_inset_into_both_images_where_it_is_told_while_running() {
    let mut bench = Bench::<Pip>::new(r#"{"x": 0, "y": 0}"#);
    bench.push_frame("inset", header(1, 1, PixelFormat::GRAY8), &[8, 9]);
    let big = header(3, 1, PixelFormat::GRAY8);
    bench.push_frame("image", big, &[0; 6]);
    bench.step(1);
    assert_eq!(out(&mut bench), [(big, vec![8, 0, 0, 9, 0, 0])]);
    bench.configure(r#"{"x": 2, "y": 0}"#).unwrap();
    bench.push_frame("image", big, &[0; 6]);
    bench.step(1);
    assert_eq!(out(&mut bench), [(big, vec![0, 0, 8, 0, 0, 9])]);
    assert!(bench.state().inset_shown.get());
}

#[test]
fn pip_hides_an_inset_that_is_switched_off_missing_or_stale() {
    let mut bench = Bench::<Pip>::new(r#"{"x": 0, "y": 0}"#);
    let big = header(2, 1, PixelFormat::GRAY8);
    let shown = |bench: &mut Bench<Pip>| {
        bench.push_frame("image", big, &[0; 4]);
        bench.step(1);
        out(bench) != [(big, vec![0; 4])]
    };
    assert!(!shown(&mut bench), "nothing was ever put in");
    bench.push_frame("inset", header(1, 1, PixelFormat::GRAY8), &[8, 9]);
    assert!(shown(&mut bench));
    bench.make_stale("inset");
    assert!(!shown(&mut bench), "the inset is stale");
    bench.push_frame("inset", header(1, 1, PixelFormat::GRAY8), &[8, 9]);
    bench.configure(r#"{"visible": false}"#).unwrap();
    assert!(!shown(&mut bench), "the inset is switched off");
}

#[test]
fn pip_goes_where_commands_say_in_the_size_and_strength_they_say() {
    let mut bench = Bench::<Pip>::new(r#"{"x": 0, "y": 0}"#);
    let (big, small) = (header(4, 2, PixelFormat::GRAY8), header(1, 1, PixelFormat::GRAY8));
    bench.push_frame("inset", small, &[100, 200]);
    bench
        .command::<PipRect, ()>("inset_control/set_rect", PipRect { x: 1, y: 0, w: 2, h: 2, alpha: 0.5 })
        .unwrap();
    assert_eq!(
        filtered(&mut bench, big, &[0; 16]),
        [(big, vec![0, 50, 50, 0, 0, 50, 50, 0, 0, 100, 100, 0, 0, 100, 100, 0])]
    );
    let rect = bench.read::<(), PipRect>("inset_control/rect", ()).unwrap();
    assert_eq!((rect.x, rect.w, rect.alpha), (1, 2, 0.5));
    bench.command::<Flag, ()>("inset_control/set_visible", false.into()).unwrap();
    assert_eq!(filtered(&mut bench, big, &[0; 16]), [(big, vec![0; 16])]);
    for (rect, says) in [
        (PipRect { alpha: 1.5, ..rect }, "alpha of 1.5"),
        (PipRect { alpha: f64::NAN, ..rect }, "alpha of NaN"),
        (PipRect { w: 1921, ..rect }, "1921 × 2 px is larger than max_width × max_height, 1920 × 1080 px"),
        (PipRect { h: u32::MAX, ..rect }, "4294967295 px is larger"),
    ] {
        let why = bench.command::<PipRect, ()>("inset_control/set_rect", rect).unwrap_err().to_string();
        assert!(why.contains(says), "{why}");
    }
}

#[test]
fn pip_shows_a_single_picture_to_both_eyes_while_there_is_no_pair() {
    let mut bench = Bench::<Pip>::new(r#"{"x": 0, "y": 0, "max_width": 4, "max_height": 2}"#);
    bench.push_frame("picture", picture(2, 1, PixelFormat::RGB8), &[255, 0, 0, 0, 0, 255]);
    let seen = [77, 29, 0, 0, 0, 0, 0, 0].repeat(2);
    assert_eq!(over_black(&mut bench), seen, "colours become grey");
    set_rect(&mut bench, 1, 2);
    assert_eq!(over_black(&mut bench), [53, 0, 0, 0, 53, 0, 0, 0].repeat(2), "and their mean in one pixel");
    bench.push_frame("inset", header(1, 1, PixelFormat::GRAY8), &[8, 9]);
    assert_eq!(
        over_black(&mut bench),
        [8, 0, 0, 0, 8, 0, 0, 0, 9, 0, 0, 0, 9, 0, 0, 0],
        "a pair comes first"
    );
    bench.make_stale("inset");
    assert_eq!(over_black(&mut bench), [53, 0, 0, 0, 53, 0, 0, 0].repeat(2));
    bench.make_stale("picture");
    assert_eq!(over_black(&mut bench), [0; 16]);
    assert!(!bench.state().inset_shown.get());
}

#[test]
fn an_inset_is_brought_to_its_size_once_and_anew_when_another_one_or_another_size_comes() {
    let mut bench = Bench::<Pip>::new(r#"{"x": 0, "y": 0, "w": 2, "h": 2, "max_width": 4, "max_height": 2}"#);
    let scaled = |bench: &Bench<Pip>| bench.state().insets.frames;
    bench.push_frame("picture", picture(1, 1, PixelFormat::GRAY8), &[10]);
    for _ in 0..3 {
        assert_eq!(over_black(&mut bench), [10, 10, 0, 0, 10, 10, 0, 0].repeat(2));
    }
    assert_eq!(scaled(&bench), 1);
    bench.push_frame("picture", picture(1, 1, PixelFormat::GRAY8), &[20]);
    for _ in 0..3 {
        assert_eq!(over_black(&mut bench), [20, 20, 0, 0, 20, 20, 0, 0].repeat(2));
    }
    assert_eq!(scaled(&bench), 2);
    set_rect(&mut bench, 1, 2);
    for _ in 0..3 {
        assert_eq!(over_black(&mut bench), [20, 0, 0, 0, 20, 0, 0, 0].repeat(2));
    }
    assert_eq!(scaled(&bench), 3);
    // A pair and a picture with the same number and stamp are not taken for each other.
    bench.push_frame("inset", header(1, 1, PixelFormat::GRAY8), &[30, 40]);
    assert_eq!(over_black(&mut bench), [30, 0, 0, 0, 30, 0, 0, 0, 40, 0, 0, 0, 40, 0, 0, 0]);
}

#[test]
fn an_inset_that_cannot_be_shown_is_told_once_and_the_picture_goes_on_without_it() {
    let mut bench = Bench::<Pip>::new(r#"{"x": 0, "y": 0, "max_width": 4, "max_height": 2}"#);
    let lying = ImageHeader { height: u32::MAX, ..picture(1, 1, PixelFormat::GRAY8) };
    let small = picture(1, 1, PixelFormat::GRAY8);
    let cases = [
        (lying, 1, "repair the source"),
        (picture(1, 1, PixelFormat::DEPTH32F), 4, "GRAY8 or RGB8"),
        (ImageHeader { format: PixelFormat(77), ..small }, 4, "GRAY8 or RGB8"),
        (picture(0, 1, PixelFormat::GRAY8), 1, "repair the source"),
    ];
    for (n, (header, bytes, says)) in (1..).zip(cases) {
        bench.push_frame("picture", header, &vec![50; bytes]);
        for _ in 0..2 {
            assert_eq!(over_black(&mut bench), [0; 16]);
        }
        let insets = bench.state().insets;
        assert_eq!(insets.rejected, n, "{header:?}");
        assert!(insets.problem.contains(says), "{}", insets.problem);
    }
    // As high as it comes is higher than there is room for, when it has to be made wider.
    bench.push_frame("picture", picture(1, 3, PixelFormat::GRAY8), &[50; 3]);
    set_rect(&mut bench, 2, 0);
    assert_eq!(over_black(&mut bench), [0; 16]);
    assert!(bench.state().insets.problem.contains("max_height"), "{}", bench.state().insets.problem);
    assert_eq!(bench.state().tally.rejected, 0, "no picture was lost");
    // In its own size it is cut.
    set_rect(&mut bench, 0, 0);
    assert_eq!(over_black(&mut bench), [50, 0, 0, 0, 50, 0, 0, 0].repeat(2));
}

#[test]
fn an_inset_larger_than_the_frames_is_refused_in_the_configuration() {
    let mut bench = Bench::<Pip>::created();
    let why = bench.configure(r#"{"w": 5, "h": 1, "max_width": 4, "max_height": 2}"#).unwrap_err().reason;
    assert!(why.contains("5 × 1 px is larger than max_width × max_height, 4 × 2 px"), "{why}");
}

#[test]
fn another_size_another_inset_and_another_kind_of_it_allocate_nothing() {
    let mut bench = Bench::<Pip>::new(r#"{"x": 0, "y": 0, "max_width": 64, "max_height": 48}"#);
    let big = header(64, 48, PixelFormat::RGB8);
    bench.assert_no_alloc(|bench| {
        for (n, (w, h)) in (0..).zip([(1, 1), (64, 48), (7, 33), (0, 0), (64, 1)]) {
            set_rect(bench, w, h);
            bench.push_frame("picture", picture(32 + n, 40, PixelFormat::GRAY8), &[9; 40 * 40]);
            bench.push_frame("image", big, &[0; 2 * 3 * 64 * 48]);
            bench.step(1);
            bench.push_frame("inset", header(5 + n, 9, PixelFormat::RGB8), &[9; 2 * 3 * 10 * 9]);
            bench.push_frame("image", big, &[0; 2 * 3 * 64 * 48]);
            bench.step(1);
            bench.make_stale("inset");
        }
    });
    let state = bench.state();
    assert_eq!((state.tally.frames, state.insets.frames, state.insets.rejected), (10, 10, 0));
}

/// A black pair under a picture of 100 × 50 px, and what of it is not black, as rows of the left image.
fn with_axes(config: &str) -> Vec<usize> {
    let mut bench = Bench::<Pip>::new(config);
    bench.push_frame("picture", picture(100, 50, PixelFormat::GRAY8), &[9; 5000]);
    let (_, bytes) =
        filtered(&mut bench, header(320, 240, PixelFormat::GRAY8), &[0; 2 * 320 * 240]).remove(0);
    bench.assert_no_alloc(|bench| bench.step(1));
    let (left, right) = bytes.split_at(320 * 240);
    assert_eq!(left, right, "one picture for both eyes");
    left.chunks_exact(320).map(|row| row.iter().filter(|level| **level > 0).count()).collect()
}

#[test]
fn an_inset_whose_pixels_have_a_size_has_axes_and_the_stretch_says_its_height() {
    // 100 columns of 10 µm are 1 mm, 50 rows of 5 µm a quarter of it: 200 px wide it is 50 px high, twice
    // stretched 100 px.
    let plain = with_axes(r#"{"x": 0, "y": 0, "w": 200, "h": 150}"#);
    assert_eq!((plain[0], plain[149], plain[150]), (200, 200, 0));
    let config = r#"{"x": 0, "y": 0, "w": 200, "h": 150, "columns_m": 1e-5, "rows_m": 5e-6, "stretch": 2}"#;
    let scaled = with_axes(config);
    assert_eq!((scaled[0], scaled[99], scaled[100]), (200, 200, 0));
}

#[test]
fn axes_are_drawn_into_the_inset_alone_and_measure_it_as_it_is_shown() {
    let mut bench = Bench::<Pip>::new(r#"{"x": 10, "y": 20, "w": 200, "h": 100, "columns_m": 1e-5}"#);
    bench.push_frame("picture", picture(100, 50, PixelFormat::GRAY8), &[0; 5000]);
    let (_, bytes) =
        filtered(&mut bench, header(320, 240, PixelFormat::GRAY8), &[0; 2 * 320 * 240]).remove(0);
    // A column of 10 µm is two pixels wide; a bar of at most 60 px is 200 µm, 40 px, two of its rows above
    // the letters.
    let row = 20 + 100 - 2 - 5 - 16 - 10 - 2;
    let inked: Vec<usize> = (0..320).filter(|x| bytes[row * 320 + x] == 235).collect();
    assert_eq!((inked.len(), inked.last()), (40, Some(&199)));
    assert!(bytes[..20 * 320].iter().chain(&bytes[120 * 320..240 * 320]).all(|level| *level == 0));
}

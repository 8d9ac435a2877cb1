//! The filters on the bench, on frames of a few pixels.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::Class;
use trocar_sdk::data::{PixelFormat, StereoHeader};
use trocar_sdk::testing::Bench;

/// Two images of one row of `width` pixels each.
fn header(index: u64, width: u32, format: PixelFormat) -> StereoHeader {
    let stride = width * format.bytes_per_pixel() as u32;
    StereoHeader {
        index,
        width,
        height: 1,
        stride,
        format,
        right_offset: u64::from(stride),
        ..Default::default()
    }
}

/// Frames of the class's only output.
fn out<C: Class>(bench: &mut Bench<C>) -> Vec<(StereoHeader, Vec<u8>)> {
    bench
        .frames::<StereoHeader>(C::DESC.outputs[0].name)
        .into_iter()
        .map(|(h, bytes, _)| (h, bytes))
        .collect()
}

#[test]
fn gray_makes_both_images_grey_and_keeps_index_and_stamp() {
    let mut bench = Bench::<Gray>::new("{}");
    bench.push_frame("image", header(7, 1, PixelFormat::RGB8), &[255, 0, 0, 0, 255, 0]);
    let pushed = bench.now();
    bench.step(2);
    assert_eq!(
        bench.frames::<StereoHeader>("gray"),
        [(header(7, 1, PixelFormat::GRAY8), vec![77, 149], pushed)]
    );
    assert_eq!(bench.state().tally.frames, 1);
}

#[test]
fn gray_lets_grey_frames_pass() {
    let mut bench = Bench::<Gray>::new("{}");
    let grey = header(1, 2, PixelFormat::GRAY8);
    bench.push_frame("image", grey, &[1, 2, 3, 4]);
    bench.step(1);
    assert_eq!(out(&mut bench), [(grey, vec![1, 2, 3, 4])]);
}

#[test]
fn a_frame_that_lies_about_its_size_is_counted_and_the_next_one_is_taken() {
    let mut bench = Bench::<Gray>::new("{}");
    let lying = [
        StereoHeader { right_offset: 4, ..header(1, 1, PixelFormat::RGB8) },
        StereoHeader { right_offset: u64::MAX, ..header(1, 1, PixelFormat::RGB8) },
        StereoHeader { width: u32::MAX, ..header(1, 1, PixelFormat::RGB8) },
        StereoHeader { stride: 1, ..header(1, 1, PixelFormat::RGB8) },
        header(1, 0, PixelFormat::RGB8),
    ];
    for (n, header) in (1..).zip(lying) {
        bench.push_frame("image", header, &[0; 6]);
        bench.step(1);
        assert_eq!(bench.state().tally.rejected, n, "{header:?}");
    }
    assert!(bench.state().tally.problem.contains("right_offset"), "{}", bench.state().tally.problem);
    bench.push_frame("image", header(2, 1, PixelFormat::RGB8), &[0; 6]);
    bench.step(1);
    assert_eq!(bench.state().tally.frames, 1);
}

#[test]
fn unknown_formats_too_large_frames_and_a_full_pool_each_say_what_to_do() {
    let mut bench = Bench::<Gray>::new(r#"{"max_width": 1, "max_height": 1}"#);
    bench.push_frame("image", header(1, 1, PixelFormat::GRAY16), &[0; 4]);
    bench.step(1);
    assert!(bench.state().tally.problem.contains("not GRAY8, RGB8, BGR8, RGBA8 or YUYV"));
    bench.push_frame("image", header(1, 2, PixelFormat::RGB8), &[0; 12]);
    bench.step(1);
    assert!(bench.state().tally.problem.contains("max_width"));
    bench.exhaust("gray", true);
    bench.push_frame("image", header(1, 1, PixelFormat::RGB8), &[0; 6]);
    bench.step(1);
    assert!(bench.state().tally.problem.contains("held by readers"));
    assert_eq!((bench.state().tally.frames, bench.state().tally.rejected), (0, 3));
    assert!(out(&mut bench).is_empty());
}

#[test]
fn resize_brings_both_images_of_any_size_and_format_to_one_size() {
    let mut bench = Bench::<Resize>::new(r#"{"width": 1, "height": 1, "from_width": 2, "from_height": 1}"#);
    bench.push_frame("image", header(1, 2, PixelFormat::GRAY8), &[0, 10, 100, 200]);
    bench.step(1);
    bench.push_frame("image", header(2, 4, PixelFormat::GRAY8), &[0, 0, 4, 4, 8, 8, 8, 8]);
    bench.step(1);
    bench.push_frame("image", header(3, 1, PixelFormat::RGB8), &[1, 2, 3, 4, 5, 6]);
    bench.step(1);
    assert_eq!(
        out(&mut bench),
        [
            (header(1, 1, PixelFormat::GRAY8), vec![5, 150]),
            (header(2, 1, PixelFormat::GRAY8), vec![2, 8]),
            (header(3, 1, PixelFormat::RGB8), vec![1, 2, 3, 4, 5, 6]),
        ]
    );
}

#[test]
fn resize_takes_images_up_to_its_longest_side_and_no_longer_ones() {
    let mut bench = Bench::<Resize>::new(r#"{"width": 2, "height": 2}"#);
    bench.push_frame("image", header(1, 16_384, PixelFormat::GRAY8), &[100; 2 * 16_384]);
    bench.step(1);
    assert_eq!(out(&mut bench).remove(0).1, [100; 8]);
    bench.push_frame("image", header(1, 16_385, PixelFormat::GRAY8), &[100; 2 * 16_385]);
    bench.step(1);
    assert!(bench.state().tally.problem.contains("more than 16384 px"), "{}", bench.state().tally.problem);
}

#[test]
fn resize_refuses_a_method_that_does_not_exist() {
    let refused = Bench::<Resize>::created().configure(r#"{"method": "cubic"}"#).unwrap_err();
    assert_eq!(refused.reason, r#"method: "cubic" is not one of "area", "bilinear""#);
}

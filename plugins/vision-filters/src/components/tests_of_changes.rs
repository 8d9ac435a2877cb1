//! Filters that change size, colour or place of pixels, and what is drawn over them, on the bench.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::Class;
use trocar_sdk::Text;
use trocar_sdk::data::{PixelFormat, StereoHeader};
use trocar_sdk::testing::Bench;

trocar_sdk::testing::count_allocations!();

/// Two images with touching rows.
fn header(width: u32, height: u32, format: PixelFormat) -> StereoHeader {
    let stride = width * format.bytes_per_pixel() as u32;
    let right_offset = u64::from(stride * height);
    StereoHeader { index: 1, width, height, stride, format, right_offset, ..Default::default() }
}

/// Gives a frame to the class, and returns what its only output gives.
fn filtered<C: Class>(
    bench: &mut Bench<C>,
    header: StereoHeader,
    bytes: &[u8],
) -> Vec<(StereoHeader, Vec<u8>)> {
    bench.push_frame("image", header, bytes);
    bench.step(1);
    bench
        .frames::<StereoHeader>(C::DESC.outputs[0].name)
        .into_iter()
        .map(|(h, bytes, _)| (h, bytes))
        .collect()
}

#[test]
fn color_brings_every_format_to_the_one_that_is_asked_for() {
    let mut bench = Bench::<Color>::new("{}");
    let bgr = header(1, 1, PixelFormat::BGR8);
    assert_eq!(
        filtered(&mut bench, bgr, &[1, 2, 3, 4, 5, 6]),
        [(header(1, 1, PixelFormat::RGB8), vec![3, 2, 1, 6, 5, 4])]
    );
    let yuyv = header(2, 1, PixelFormat::YUYV);
    let out = filtered(&mut bench, yuyv, &[16, 128, 235, 128, 235, 128, 16, 128]);
    assert_eq!(
        out,
        [(header(2, 1, PixelFormat::RGB8), vec![0, 0, 0, 255, 255, 255, 255, 255, 255, 0, 0, 0])]
    );
    bench.configure(r#"{"to": "gray8"}"#).unwrap();
    let rgba = header(1, 1, PixelFormat::RGBA8);
    let out = filtered(&mut bench, rgba, &[255, 0, 0, 9, 0, 255, 0, 9]);
    assert_eq!(out, [(header(1, 1, PixelFormat::GRAY8), vec![77, 149])]);
    bench.configure(r#"{"to": "bgr8"}"#).unwrap();
    let out = filtered(&mut bench, header(1, 1, PixelFormat::RGB8), &[1, 2, 3, 4, 5, 6]);
    assert_eq!(out, [(bgr, vec![3, 2, 1, 6, 5, 4])]);
    assert_eq!(filtered(&mut bench, bgr, &[1, 2, 3, 4, 5, 6]), [(bgr, vec![1, 2, 3, 4, 5, 6])], "it passes");
    assert!(filtered(&mut bench, header(1, 1, PixelFormat::GRAY16), &[0; 4]).is_empty());
    assert!(bench.state().tally.problem.contains("YUYV"));
}

#[test]
fn debayer_gives_colours_and_refuses_what_has_no_pattern() {
    let mut bench = Bench::<Debayer>::new("{}");
    let bayer = header(2, 2, PixelFormat::BAYER_RG8);
    let out = filtered(&mut bench, bayer, &[200, 100, 100, 50, 10, 20, 20, 30]);
    let colours = [[200, 100, 50].repeat(4), [10, 20, 30].repeat(4)].concat();
    assert_eq!(out, [(header(2, 2, PixelFormat::RGB8), colours)]);
    let rgb = header(1, 1, PixelFormat::RGB8);
    assert_eq!(filtered(&mut bench, rgb, &[1; 6]), [(rgb, vec![1; 6])]);
    assert!(filtered(&mut bench, header(3, 1, PixelFormat::BAYER_RG8), &[0; 6]).is_empty());
    assert!(bench.state().tally.problem.contains("2 x 2"));
    assert!(filtered(&mut bench, header(2, 2, PixelFormat::YUYV), &[0; 16]).is_empty());
    assert!(bench.state().tally.problem.contains("BAYER_RG8"));
    assert!(filtered(&mut bench, StereoHeader { stride: 1, ..bayer }, &[0; 8]).is_empty());
    assert!(bench.state().tally.problem.contains("stride"));
}

#[test]
fn crop_cuts_the_same_part_out_of_both_images_and_moves_while_it_runs() {
    let config = |x: u32| format!(r#"{{"x": {x}, "y": 1, "width": 2, "height": 1}}"#);
    let mut bench = Bench::<Crop>::new(config(0));
    let image = header(3, 2, PixelFormat::GRAY8);
    let bytes = [1, 2, 3, 4, 5, 6, 11, 12, 13, 14, 15, 16];
    let part = header(2, 1, PixelFormat::GRAY8);
    assert_eq!(filtered(&mut bench, image, &bytes), [(part, vec![4, 5, 14, 15])]);
    bench.configure(config(1)).unwrap();
    assert_eq!(filtered(&mut bench, image, &bytes), [(part, vec![5, 6, 15, 16])]);
    bench.configure(config(2)).unwrap();
    assert!(filtered(&mut bench, image, &bytes).is_empty());
    assert!(bench.state().tally.problem.contains("beyond the image"));
}

#[test]
fn flip_mirrors_both_images_and_changes_eyes_when_asked() {
    let mut bench = Bench::<Flip>::new(r#"{"direction": "horizontal"}"#);
    let image = header(2, 1, PixelFormat::RGB8);
    let bytes = [1, 2, 3, 4, 5, 6, 11, 12, 13, 14, 15, 16];
    assert_eq!(
        filtered(&mut bench, image, &bytes),
        [(image, vec![4, 5, 6, 1, 2, 3, 14, 15, 16, 11, 12, 13])]
    );
    bench.configure(r#"{"direction": "none", "swap_eyes": true}"#).unwrap();
    assert_eq!(
        filtered(&mut bench, image, &bytes),
        [(image, vec![11, 12, 13, 14, 15, 16, 1, 2, 3, 4, 5, 6])]
    );
    bench.configure(r#"{"direction": "none"}"#).unwrap();
    assert_eq!(filtered(&mut bench, image, &bytes), [(image, bytes.to_vec())]);
    assert!(
        filtered(&mut bench, header(2, 1, PixelFormat::YUYV), &bytes).is_empty(),
        "its pattern would break"
    );
}

#[test]
fn exposure_changes_levels_while_it_runs() {
    let mut bench = Bench::<Exposure>::new("{}");
    let image = header(2, 1, PixelFormat::GRAY8);
    assert_eq!(filtered(&mut bench, image, &[1, 2, 3, 4]), [(image, vec![1, 2, 3, 4])]);
    bench.configure(r#"{"gain": 2.0}"#).unwrap();
    assert_eq!(filtered(&mut bench, image, &[10, 100, 200, 0]), [(image, vec![20, 200, 255, 0])]);
    assert!(Bench::<Exposure>::created().configure(r#"{"gamma": 0}"#).unwrap_err().reason.contains("gamma"));
    assert!(filtered(&mut bench, header(2, 1, PixelFormat::YUYV), &[0; 8]).is_empty());
    assert!(bench.state().tally.problem.contains("GRAY8 or RGB8"));
}

#[test]
fn a_frame_that_others_read_too_is_copied_with_the_same_result() {
    fn both_ways<C: Class>(config: &str) {
        let mut bench = Bench::<C>::new(config);
        let image = header(3, 2, PixelFormat::GRAY8);
        let bytes: Vec<u8> = (1..13).collect();
        if C::DESC.inputs.len() > 1 {
            bench.push_frame("inset", header(1, 1, PixelFormat::GRAY8), &[100, 200]);
        }
        // With a gap behind each row, which a copy does not have.
        let gaps = StereoHeader { stride: 4, right_offset: 8, ..image };
        let wide: Vec<u8> = bytes.chunks(3).flat_map(|row| [row, &[99]].concat()).collect();
        bench.share("image", true);
        let copied = filtered(&mut bench, gaps, &wide).remove(0);
        assert_eq!(copied.0, image);
        bench.share("image", false);
        assert_eq!(filtered(&mut bench, image, &bytes), [(image, copied.1.clone())]);
        assert_ne!(copied.1, bytes, "something was changed");
        let in_place = filtered(&mut bench, gaps, &wide).remove(0);
        assert_eq!(in_place.0, gaps);
        assert_eq!(in_place.1.chunks(4).flat_map(|row| row[..3].to_vec()).collect::<Vec<u8>>(), copied.1);
    }
    both_ways::<Flip>(r#"{"direction": "both"}"#);
    both_ways::<Exposure>(r#"{"gain": 3.0}"#);
    both_ways::<Pip>(r#"{"x": 1, "y": 0}"#);
}

#[test]
fn one_image_for_both_eyes_and_pairs_side_by_side_are_changed_alone_as_beside_other_readers() {
    fn every_layout<C: Class>(config: &str, set: impl Fn(&mut Bench<C>)) {
        let image = header(3, 2, PixelFormat::GRAY8);
        let (left, right): (Vec<u8>, Vec<u8>) = ((1..7).collect(), (7..13).collect());
        let beside: Vec<u8> =
            left.chunks(3).zip(right.chunks(3)).flat_map(|(l, r)| [l, r].concat()).collect();
        for (laid, bytes, both) in [
            (StereoHeader { right_offset: 0, ..image }, left.clone(), [&left[..], &left[..]].concat()),
            (StereoHeader { stride: 6, right_offset: 3, ..image }, beside, [&left[..], &right[..]].concat()),
        ] {
            for shared in [false, true] {
                let mut bench = Bench::<C>::new(config);
                set(&mut bench);
                let stacked = filtered(&mut bench, image, &both);
                assert_ne!(stacked[0].1, both, "something was changed");
                bench.share("image", shared);
                assert_eq!(filtered(&mut bench, laid, &bytes), stacked, "shared: {shared}");
            }
        }
    }
    every_layout::<Flip>(r#"{"direction": "both"}"#, |_| {});
    every_layout::<Exposure>(r#"{"gain": 3.0}"#, |_| {});
    every_layout::<Pip>(r#"{"x": 1, "y": 0}"#, |bench| {
        bench.push_frame("inset", header(1, 1, PixelFormat::GRAY8), &[100, 200]);
    });
    every_layout::<Overlay>("{}", |bench| {
        let line = OverlayLine { to: [2, 0], width: 1, color: [255; 4], ..Default::default() };
        bench.command::<OverlayLine, ()>("items/set_line", line).unwrap();
    });
}

#[test]
fn images_that_lie_in_each_other_are_not_changed_in_place() {
    let mut bench = Bench::<Flip>::new("{}");
    let lying = StereoHeader { right_offset: 1, ..header(2, 1, PixelFormat::GRAY8) };
    filtered(&mut bench, lying, &[1, 2, 3]);
    let tally = bench.state().tally;
    assert_eq!((tally.frames, tally.rejected), (0, 1));
    assert!(tally.problem.contains("right_offset lies in the left image"), "{}", tally.problem);
}

fn ink(bytes: &[u8]) -> usize {
    bytes.iter().filter(|&&b| b > 0).count()
}

#[test]
fn overlay_draws_what_commands_set_in_the_eye_that_they_say() {
    let mut bench = Bench::<Overlay>::new("{}");
    let image = header(60, 30, PixelFormat::GRAY8);
    let black = vec![0; 3600];
    assert_eq!(filtered(&mut bench, image, &black), [(image, black.clone())], "nothing is set");
    let text = OverlayText {
        text: Text::new("OK"),
        item: 3,
        x: 4,
        y: 4,
        size: 16,
        color: [255; 4],
        eye: Eye::BOTH,
        disparity: 4,
        ..Default::default()
    };
    bench.command::<OverlayText, ()>("items/set_text", text).unwrap();
    let out = filtered(&mut bench, image, &black).remove(0).1;
    let (left, right) = out.split_at(1800);
    assert!(ink(left) > 20);
    // In the right image it is 4 px further left.
    assert!(left.chunks(60).zip(right.chunks(60)).all(|(l, r)| l[4..] == r[..56]));
    let line = OverlayLine {
        item: 3,
        from: [0, 0],
        to: [59, 29],
        width: 1,
        color: [255; 4],
        eye: Eye::LEFT,
        disparity: 0,
    };
    bench.command::<OverlayLine, ()>("items/set_line", line).unwrap();
    assert_eq!(bench.read::<(), u64>("items/items", ()).unwrap(), 1, "the line took the text's place");
    let out = filtered(&mut bench, image, &black).remove(0).1;
    assert!(ink(&out[..1800]) >= 60 && ink(&out[1800..]) == 0);
    bench.configure(r#"{"visible": false}"#).unwrap();
    assert_eq!(ink(&filtered(&mut bench, image, &black).remove(0).1), 0);
    bench.configure("{}").unwrap();
    bench.command::<u32, ()>("items/remove", 3).unwrap();
    assert_eq!(ink(&filtered(&mut bench, image, &black).remove(0).1), 0);
}

#[test]
fn overlay_refuses_items_that_cannot_be() {
    let mut bench = Bench::<Overlay>::new("{}");
    let refused = |bench: &mut Bench<Overlay>, line| {
        bench.command::<OverlayLine, ()>("items/set_line", line).unwrap_err().to_string()
    };
    let line = OverlayLine { width: 1, ..Default::default() };
    assert!(refused(&mut bench, OverlayLine { item: 32, ..line }).contains("item 32 is above 31"));
    assert!(refused(&mut bench, OverlayLine { width: 0, ..line }).contains("0 px is not 1 to 64"));
    assert!(refused(&mut bench, OverlayLine { eye: Eye(5), ..line }).contains("none of BOTH"));
    let picture = OverlayPicture { picture: 1, ..Default::default() };
    let why = bench.command::<OverlayPicture, ()>("items/set_picture", picture).unwrap_err().to_string();
    assert!(why.contains("no picture 1: 0 are configured"), "{why}");
    let why = Bench::<Overlay>::created().configure(r#"{"pictures": ["nowhere.png"]}"#).unwrap_err().reason;
    assert!(why.contains("nowhere.png: cannot be opened"), "{why}");
}

#[test]
fn overlay_lays_a_picture_of_a_file() {
    let picture = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/retina.jpg");
    let mut bench = Bench::<Overlay>::new(format!(r#"{{"pictures": ["{picture}"]}}"#));
    let image = header(40, 40, PixelFormat::RGB8);
    let item = OverlayPicture { x: -700, y: -700, alpha: 255, ..Default::default() };
    bench.command::<OverlayPicture, ()>("items/set_picture", item).unwrap();
    let out = filtered(&mut bench, image, &[0; 9600]).remove(0).1;
    assert!(out.chunks(3).all(|p| p[0] > p[2]), "the middle of a retina is red");
}

#[test]
fn overlay_reads_its_files_when_it_is_stopped_and_not_when_a_setting_changes_while_it_runs() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("mark.png");
    let save = |level: u8| image::GrayImage::from_pixel(1, 1, image::Luma([level])).save(&path).unwrap();
    let config = |visible: bool| format!(r#"{{"pictures": [{path:?}], "visible": {visible}}}"#);
    save(200);
    let mut bench = Bench::<Overlay>::new(config(true));
    let item = OverlayPicture { alpha: 255, ..Default::default() };
    bench.command::<OverlayPicture, ()>("items/set_picture", item).unwrap();
    let image = header(1, 1, PixelFormat::GRAY8);
    let shown = |bench: &mut Bench<Overlay>| filtered(bench, image, &[0; 2]).remove(0).1[0];
    assert_eq!(shown(&mut bench), 200);
    // Neither another file nor none is noticed while it runs.
    save(100);
    bench.configure(config(true)).unwrap();
    assert_eq!(shown(&mut bench), 200);
    std::fs::remove_file(&path).unwrap();
    bench.configure(config(false)).unwrap();
    bench.configure(config(true)).unwrap();
    assert_eq!(shown(&mut bench), 200);
    save(50);
    bench.stop().unwrap();
    bench.configure(config(true)).unwrap();
    bench.start().unwrap();
    assert_eq!(shown(&mut bench), 50, "what is configured at rest is read");
}

#[test]
fn steps_of_the_filters_allocate_nothing() {
    fn quiet<C: Class>(config: &str, header: StereoHeader, bytes: &[u8]) {
        let mut bench = Bench::<C>::new(config);
        bench.assert_no_alloc(|bench| {
            bench.push_frame("image", header, bytes);
            bench.step(1);
        });
        assert_eq!(bench.frames::<StereoHeader>(C::DESC.outputs[0].name).len(), 1, "{config}");
    }
    let rgb = header(8, 8, PixelFormat::RGB8);
    quiet::<Color>(r#"{"to": "bgr8"}"#, rgb, &[7; 384]);
    quiet::<Debayer>("{}", header(8, 8, PixelFormat::BAYER_RG8), &[7; 128]);
    quiet::<Crop>(r#"{"width": 4, "height": 4}"#, rgb, &[7; 384]);
    quiet::<Flip>("{}", rgb, &[7; 384]);
    quiet::<Exposure>(r#"{"gain": 2.0}"#, rgb, &[7; 384]);
    quiet::<Gray>("{}", rgb, &[7; 384]);
}

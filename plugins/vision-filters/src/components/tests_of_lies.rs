//! Headers that lie, into every class: counted, left out, and the next good frame is taken as if nothing had
//! been; and frames laid out otherwise, or of another size than the one before. Nothing of this allocates in
//! a step.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::Class;
use trocar_sdk::data::{ImageHeader, PixelFormat, StereoHeader};
use trocar_sdk::testing::Bench;

/// Two images with touching rows.
fn header(width: u32, height: u32, format: PixelFormat) -> StereoHeader {
    let stride = width * format.bytes_per_pixel() as u32;
    let right_offset = u64::from(stride * height);
    StereoHeader { index: 1, width, height, stride, format, right_offset, ..Default::default() }
}

fn size(of: &StereoHeader) -> usize {
    2 * of.right_offset as usize
}

fn noise(bytes: usize) -> Vec<u8> {
    let mut random = fastrand::Rng::with_seed(bytes as u64);
    (0..bytes).map(|_| random.u8(..)).collect()
}

/// Headers that are not true for a frame with so many bytes, made of one that is true for `size(good)`.
fn lies(good: StereoHeader) -> Vec<(StereoHeader, usize)> {
    let (row, all) = (good.stride, size(&good));
    let format = |format| StereoHeader { format, ..good };
    let right = |right_offset| StereoHeader { right_offset, ..good };
    let mut lies: Vec<(StereoHeader, usize)> = [0, good.width + 1, 1 << 31, u32::MAX]
        .map(|width| StereoHeader { width, ..good })
        .into_iter()
        .chain([0, good.height + 1, 1 << 31, u32::MAX].map(|height| StereoHeader { height, ..good }))
        .chain([0, 1, row - 1, row + 1, 1 << 31, u32::MAX].map(|stride| StereoHeader { stride, ..good }))
        .chain([PixelFormat(0), PixelFormat(77), PixelFormat(u32::MAX)].map(format))
        .chain([PixelFormat::GRAY16, PixelFormat::DISPARITY16, PixelFormat::DEPTH32F].map(format))
        .chain([good.right_offset + 1, all as u64 - 1, all as u64, 1 << 63, u64::MAX].map(right))
        .map(|header| (header, all))
        .collect();
    lies.extend([0, 1, all / 2, all - 1].map(|bytes| (good, bytes)));
    let most = StereoHeader { width: u32::MAX, height: u32::MAX, stride: u32::MAX, ..right(u64::MAX) };
    lies.extend([(most, all), (StereoHeader::default(), all), (StereoHeader::default(), 0)]);
    lies
}

/// Pixels of both images of each frame that came out, rows touching: what is seen, however it is laid out.
fn seen<C: Class>(bench: &mut Bench<C>) -> Vec<Vec<u8>> {
    let frames = bench.frames::<StereoHeader>(C::DESC.outputs[0].name);
    let pixels = |(header, bytes, _): &(StereoHeader, Vec<u8>, _)| {
        let images = header.images(bytes).unwrap();
        images.iter().flat_map(|image| image.rows()).flatten().copied().collect()
    };
    frames.iter().map(pixels).collect()
}

fn quietly<C: Class>(bench: &mut Bench<C>, header: StereoHeader, bytes: &[u8]) {
    bench.assert_no_alloc(|bench| {
        bench.push_frame("image", header, bytes);
        bench.step(1);
    });
}

/// A row of the table: facts about a class.
struct Row<C: Class> {
    config: String,
    good: StereoHeader,
    /// Makes it change what comes.
    set: fn(&mut Bench<C>),
    tally: fn(&Bench<C>) -> Tally,
    /// Header of another size and format, and whether the class takes it.
    other: (StereoHeader, bool),
}

impl<C: Class> Row<C> {
    fn bench(&self) -> Bench<C> {
        let mut bench = Bench::<C>::new(&self.config);
        (self.set)(&mut bench);
        bench
    }

    fn run(&self) {
        self.lies_are_counted_and_left_out();
        self.layouts_are_the_same_to_it();
        self.sizes_may_change();
    }

    fn lies_are_counted_and_left_out(&self) {
        let bytes = noise(size(&self.good));
        for shared in [false, true] {
            let mut bench = self.bench();
            bench.share("image", shared);
            quietly(&mut bench, self.good, &bytes);
            let expected = seen(&mut bench);
            assert_eq!(expected.len(), 1, "{}: the good frame", C::DESC.name);
            for (n, (lie, there)) in (1..).zip(lies(self.good)) {
                quietly(&mut bench, lie, &bytes[..there]);
                let tally = (self.tally)(&bench);
                let class = C::DESC.name;
                assert_eq!((tally.frames, tally.rejected), (n, n), "{class}: {lie:?} with {there} B");
                assert!(!tally.problem.as_str().is_empty(), "{class}: {lie:?}");
                assert!(bench.frames::<StereoHeader>(C::DESC.outputs[0].name).is_empty(), "{class}: {lie:?}");
                quietly(&mut bench, self.good, &bytes);
                assert_eq!(seen(&mut bench), expected, "{class}: behind {lie:?}");
            }
        }
    }

    /// One image for both eyes, pairs side by side, and rows with gaps.
    fn layouts_are_the_same_to_it(&self) {
        let good = self.good;
        let (row, half) = (good.stride as usize, good.right_offset as usize);
        let (left, right) = (noise(half), noise(half + 1)[1..].to_vec());
        let rows = || left.chunks(row).zip(right.chunks(row));
        let beside: Vec<u8> = rows().flat_map(|(l, r)| [l, r].concat()).collect();
        let wide = |bytes: &[u8]| bytes.chunks(row).flat_map(|r| [r, &[9, 9]].concat()).collect::<Vec<u8>>();
        let gaps = StereoHeader { stride: good.stride + 2, right_offset: wide(&left).len() as u64, ..good };
        let both = [&left[..], &right[..]].concat();
        for (laid, bytes, stacked) in [
            (StereoHeader { right_offset: 0, ..good }, left.clone(), [&left[..], &left[..]].concat()),
            (
                StereoHeader { stride: 2 * good.stride, right_offset: row as u64, ..good },
                beside,
                both.clone(),
            ),
            (gaps, [wide(&left), wide(&right)].concat(), both),
        ] {
            for shared in [false, true] {
                let mut bench = self.bench();
                quietly(&mut bench, good, &stacked);
                let expected = seen(&mut bench);
                bench.share("image", shared);
                quietly(&mut bench, laid, &bytes);
                assert_eq!(seen(&mut bench), expected, "{}: {laid:?}, shared {shared}", C::DESC.name);
                assert_eq!((self.tally)(&bench).rejected, 0);
            }
        }
    }

    /// Frames change their size and format from one to the next.
    fn sizes_may_change(&self) {
        let (other, taken) = self.other;
        let mut bench = self.bench();
        let mut first = [None, None];
        for turn in 0..6 {
            for (which, header) in [self.good, other].into_iter().enumerate() {
                quietly(&mut bench, header, &noise(size(&header)));
                let out = seen(&mut bench);
                assert_eq!(out.len(), usize::from(which == 0 || taken), "{}: {header:?}", C::DESC.name);
                assert_eq!(*first[which].get_or_insert_with(|| out.clone()), out, "turn {turn}");
            }
        }
        let tally = (self.tally)(&bench);
        let left_out = if taken { 0 } else { 6 };
        assert_eq!((tally.frames, tally.rejected), (12 - left_out, left_out), "{}", C::DESC.name);
    }
}

const RGB: PixelFormat = PixelFormat::RGB8;

/// A class that takes RGB8 of 8 × 6 px, and GRAY8 of 5 × 7 px.
fn row<C: Class>(config: &str, set: fn(&mut Bench<C>), tally: fn(&Bench<C>) -> Tally) -> Row<C> {
    let (good, other) = (header(8, 6, RGB), header(5, 7, PixelFormat::GRAY8));
    Row { config: config.into(), good, set, tally, other: (other, true) }
}

#[test]
fn color_and_gray_take_no_lies() {
    row::<Color>(r#"{"to": "bgr8"}"#, |_| {}, |b| b.state().tally).run();
    // A frame that has the wanted format passes, but not when it is no such frame.
    row::<Color>(r#"{"to": "rgb8"}"#, |_| {}, |b| b.state().tally).run();
    row::<Gray>("{}", |_| {}, |b| b.state().tally).run();
    Row { good: header(8, 6, PixelFormat::GRAY8), ..row::<Gray>("{}", |_| {}, |b| b.state().tally) }.run();
}

#[test]
fn debayer_takes_no_lies() {
    let one = || row::<Debayer>("{}", |_| {}, |b| b.state().tally);
    Row { good: header(8, 6, PixelFormat::BAYER_RG8), ..one() }.run();
    Row { other: (header(8, 6, PixelFormat::YUYV), false), ..one() }.run();
}

#[test]
fn crop_and_resize_take_no_lies() {
    let config = r#"{"x": 1, "y": 2, "width": 4, "height": 3}"#;
    row::<Crop>(config, |_| {}, |b| b.state().tally).run();
    let small = (header(3, 3, RGB), false);
    Row { other: small, ..row::<Crop>(config, |_| {}, |b| b.state().tally) }.run();
    for (method, side) in [("area", 3), ("bilinear", 11)] {
        let config = format!(r#"{{"method": "{method}", "width": {side}, "height": {side}}}"#);
        row::<Resize>(&config, |_| {}, |b| b.state().tally).run();
    }
}

#[test]
fn filters_that_work_in_place_take_no_lies() {
    row::<Flip>(r#"{"direction": "both", "swap_eyes": true}"#, |_| {}, |b| b.state().tally).run();
    row::<Flip>(r#"{"direction": "none"}"#, |_| {}, |b| b.state().tally).run();
    row::<Exposure>(r#"{"gain": 2.0}"#, |_| {}, |b| b.state().tally).run();
    let line: fn(&mut Bench<Overlay>) = |bench| {
        let line = OverlayLine { to: [20, 3], width: 2, color: [255; 4], ..Default::default() };
        bench.command::<OverlayLine, ()>("items/set_line", line).unwrap();
        let text = OverlayText { text: trocar_sdk::Text::new("O"), item: 1, size: 16, ..Default::default() };
        bench.command::<OverlayText, ()>("items/set_text", text).unwrap();
    };
    row::<Overlay>("{}", line, |b| b.state().tally).run();
    let inset: fn(&mut Bench<Pip>) = |bench| {
        bench.push_frame("inset", header(2, 2, RGB), &noise(24));
    };
    row::<Pip>(r#"{"x": 1, "y": 1, "w": 3, "h": 3, "alpha": 0.5}"#, inset, |b| b.state().tally).run();
    row::<Pip>("{}", |_| {}, |b| b.state().tally).run();
}

#[test]
fn rectify_takes_no_lies_and_no_other_size() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("small.json");
    let side = |last: f64| {
        serde_json::json!({
            "matrix": [[8.0, 0.0, 4.0], [0.0, 8.0, 3.0], [0.0, 0.0, 1.0]],
            "distortion": [0.1, 0.0, 0.0, 0.0],
            "rectification": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            "projection": [[7.0, 0.0, 4.0, last], [0.0, 7.0, 3.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        })
    };
    let file = serde_json::json!({
        "format": "trocar-stereo-calibration", "version": 1, "image_size": [8, 6],
        "left": side(0.0), "right": side(-0.1),
    });
    std::fs::write(&path, file.to_string()).unwrap();
    let one = row::<Rectify>(&format!(r#"{{"calibration": {path:?}}}"#), |_| {}, |b| b.state().tally);
    Row { other: (header(5, 7, RGB), false), ..one }.run();
}

#[test]
fn an_inset_that_lies_is_hidden_and_counted_and_the_next_one_is_shown() {
    let mut bench = Bench::<Pip>::new(r#"{"x": 0, "y": 0, "w": 3, "h": 3}"#);
    let (big, good) = (header(8, 6, RGB), header(4, 4, PixelFormat::GRAY8));
    let (black, inset) = (vec![0; size(&big)], noise(size(&good)));
    let shown = |bench: &mut Bench<Pip>| {
        quietly(bench, big, &black);
        seen(bench).remove(0) != black
    };
    for (n, (lie, there)) in (1..).zip(lies(good)) {
        bench.push_frame("inset", lie, &inset[..there]);
        assert!(!shown(&mut bench), "{lie:?}");
        assert_eq!(bench.state().insets.rejected, n, "{lie:?}");
        bench.push_frame("inset", good, &inset);
        assert!(shown(&mut bench), "behind {lie:?}");
    }
    let one =
        ImageHeader { width: 4, height: 4, stride: 4, format: PixelFormat::GRAY8, ..Default::default() };
    bench.make_stale("inset");
    for lie in [
        ImageHeader { width: u32::MAX, ..one },
        ImageHeader { height: 5, ..one },
        ImageHeader { stride: 3, ..one },
        ImageHeader { format: PixelFormat::YUYV, ..one },
        ImageHeader::default(),
    ] {
        bench.push_frame("picture", lie, &inset[..16]);
        assert!(!shown(&mut bench), "{lie:?}");
        bench.push_frame("picture", one, &inset[..16]);
        assert!(shown(&mut bench), "behind {lie:?}");
    }
    assert_eq!(bench.state().tally.rejected, 0, "no picture was lost");
}

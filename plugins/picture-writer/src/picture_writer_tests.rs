//! Real files of frames that a test pushes, and requests that are refused.

use std::path::Path;

use super::*;
use trocar_sdk::data::PixelFormat;
use trocar_sdk::testing::Bench;

fn save(bench: &mut Bench<PictureWriter>, path: &Path) -> Result<SavedPicture, String> {
    let path = Text::new(path.to_str().unwrap());
    bench.command("ctl/save", SaveRequest { path }).map_err(|why| why.to_string())
}

fn pixels(path: &Path) -> (u32, u32, Vec<u8>) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!(info.color_type, png::ColorType::Rgb);
    (info.width, info.height, pixels)
}

/// A pair of one red and one blue pixel, taken at `at_ns`.
fn pair(at_ns: u64) -> (StereoHeader, [u8; 6]) {
    let header = StereoHeader {
        stamp: Stamp::from_ns(at_ns),
        width: 1,
        height: 1,
        stride: 3,
        format: PixelFormat::RGB8,
        right_offset: 3,
        ..Default::default()
    };
    (header, [255, 0, 0, 0, 0, 255])
}

fn gray(at_ns: u64, level: u8) -> (ImageHeader, [u8; 1]) {
    let stamp = Stamp::from_ns(at_ns);
    (ImageHeader { stamp, width: 1, height: 1, stride: 1, format: PixelFormat::GRAY8, index: 0 }, [level])
}

#[test]
fn the_newest_frame_of_both_inputs_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let mut bench = Bench::<PictureWriter>::new("{}");
    let (header, bytes) = pair(1_000);
    bench.push_frame("frame", header, &bytes);
    bench.step(1);
    bench.advance(250_000_000);
    let path = dir.path().join("pair.png");
    let saved = save(&mut bench, &path).unwrap();
    let age_s = bench.now().seconds_since(header.stamp);
    assert!(age_s > 0.25 && (saved.age - age_s).abs() < 1e-9, "{} s for {age_s} s", saved.age);
    let written = SavedPicture { bytes: path.metadata().unwrap().len(), age: saved.age, width: 2, height: 1 };
    assert_eq!(saved, written);
    assert_eq!(pixels(&path), (2, 1, bytes.to_vec()));

    let (header, bytes) = gray(2_000, 77);
    bench.push_frame("picture", header, &bytes);
    bench.step(1);
    save(&mut bench, &dir.path().join("later.png")).unwrap();
    assert_eq!(pixels(&dir.path().join("later.png")), (1, 1, vec![77; 3]));

    let (header, bytes) = pair(3_000);
    bench.push_frame("frame", header, &bytes);
    bench.configure(r#"{"part": "right"}"#).unwrap();
    bench.step(1);
    save(&mut bench, &dir.path().join("right.png")).unwrap();
    assert_eq!(pixels(&dir.path().join("right.png")), (1, 1, vec![0, 0, 255]));
    assert_eq!((bench.state().frames, bench.state().saved), (3, 3));
}

#[test]
fn only_one_input_need_be_connected() {
    let dir = tempfile::tempdir().unwrap();
    let mut bench = Bench::<PictureWriter>::new("{}");
    let (header, bytes) = gray(5, 9);
    bench.push_frame("picture", header, &bytes);
    save(&mut bench, &dir.path().join("a.png")).unwrap();
    assert_eq!(pixels(&dir.path().join("a.png")).2, [9; 3]);
}

#[test]
fn a_depth_image_is_written_in_colours() {
    let dir = tempfile::tempdir().unwrap();
    let mut bench = Bench::<PictureWriter>::new("{}");
    let depths = [0.3f32, 0.2, 0.1, f32::NAN].map(f32::to_ne_bytes).concat();
    let format = PixelFormat::DEPTH32F;
    let header = ImageHeader { width: 4, height: 1, stride: 16, format, ..Default::default() };
    bench.push_frame("picture", header, &depths);
    save(&mut bench, &dir.path().join("depth.png")).unwrap();
    let (_, _, rgb) = pixels(&dir.path().join("depth.png"));
    let light = |x: usize| rgb[3 * x..3 * x + 3].iter().map(|level| u32::from(*level)).sum::<u32>();
    assert!(light(0) < light(1) && light(1) < light(2), "the nearest is the brightest: {:?}", &rgb[..9]);
    assert!(rgb[9] == rgb[10] && rgb[10] == rgb[11], "grey where nothing is known: {:?}", &rgb[9..12]);
    for bad in ["[1]", "[1, 1]", "[2, 1]", "[1, 2, 3]"] {
        let why = bench.configure(format!(r#"{{"depth_range_m": {bad}}}"#)).unwrap_err().to_string();
        assert!(why.contains("is no range: give two numbers"), "{why}");
    }
}

#[test]
fn without_a_frame_and_with_bad_paths_it_says_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let mut bench = Bench::<PictureWriter>::new("{}");
    let why = save(&mut bench, &dir.path().join("a.png")).unwrap_err();
    assert!(why.contains("no frame has come yet: connect"), "{why}");
    let (header, bytes) = gray(5, 9);
    bench.push_frame("picture", header, &bytes);
    let why = save(&mut bench, &dir.path().join("a.jpg")).unwrap_err();
    assert!(why.contains("does not end with .png"), "{why}");
    let why = save(&mut bench, &dir.path().join("none/a.png")).unwrap_err();
    assert!(why.contains("does not exist: make it first"), "{why}");
    save(&mut bench, &dir.path().join("a.png")).unwrap();
    let why = save(&mut bench, &dir.path().join("a.png")).unwrap_err();
    assert!(why.contains("nothing is written over"), "{why}");
    assert_eq!(bench.state().saved, 1);
}

#[test]
fn a_frame_whose_header_lies_is_refused_and_leaves_no_file() {
    let dir = tempfile::tempdir().unwrap();
    let mut bench = Bench::<PictureWriter>::new("{}");
    let (header, bytes) = gray(5, 9);
    bench.push_frame("picture", ImageHeader { width: 9, stride: 9, ..header }, &bytes);
    let why = save(&mut bench, &dir.path().join("a.png")).unwrap_err();
    assert!(why.contains("the newest frame cannot be shown"), "{why}");
    assert!(!dir.path().join("a.png").exists());
}

#[test]
fn a_step_allocates_nothing() {
    let mut bench = Bench::<PictureWriter>::new("{}");
    let (header, bytes) = pair(1);
    bench.push_frame("frame", header, &bytes);
    bench.assert_no_alloc(|bench| bench.step(3));
    assert_eq!(bench.state().frames, 1);
}

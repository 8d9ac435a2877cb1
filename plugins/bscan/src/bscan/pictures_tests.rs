//! The image of a scan against the phantom's truth (gate A7), its columns, and frames that are no A-scans.
#![allow(clippy::unwrap_used)]

use trocar_sdk::data::{AScanHeader, ImageHeader, SampleFormat};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use crate::rig::{APEX_Z_M, Rig, Setup, seeds};
use crate::{BScan, Phase, ScanColumn, ScanDone, ScanRequest};

/// Where the phantom has layers below its surface, and where it has none, m of optical path.
const LAYERS_M: [f64; 3] = [35e-6, 90e-6, 240e-6];

const NO_LAYERS_M: [f64; 4] = [62e-6, 140e-6, 185e-6, 300e-6];
const BIN_M: f64 = 3.5117e-6;

/// An image of a scan, and where its columns have the surface in truth, in rows.
struct Seen {
    pixels: Vec<u8>,
    width: usize,
    truth: Vec<f64>,
}

impl Seen {
    fn of(setup: Setup) -> Seen {
        let mut rig = Rig::run(Setup { images: true, ..setup });
        let (header, pixels, _) = rig.bench.frames::<ImageHeader>("bscan_image").pop().unwrap();
        let width = header.width as usize;
        let length_m = (setup.end_m + 1.5e-3) * rig.part_across();
        let wanted = (length_m / 6e-6).round() as usize;
        let (from_m, pitch_m) = (-1.5e-3 * rig.part_across(), length_m / wanted as f64);
        assert_eq!((width, header.height, header.stride as usize), (wanted, 512, wanted));
        assert_eq!(pixels.len(), width * 512);
        let columns = rig.bench.outputs::<ScanColumn>("column");
        assert!(columns.iter().map(|c| c.column as usize).eq(0..width), "every column is there");
        assert!(columns.iter().all(|c| c.lines > 0));
        let done = rig.bench.events::<ScanDone>("scan/bscan_done");
        assert_eq!(done, [ScanDone { scan: 1, columns: width as u32, empty: 0 }]);
        let mut sums = vec![(0.0, 0.0); width];
        for t in rig.truth.iter().filter(|t| t.scanning && t.x_m >= from_m) {
            if let Some((sum, count)) = sums.get_mut(((t.x_m - from_m) / pitch_m) as usize) {
                *sum += t.ilm_m * 1.336 / BIN_M;
                *count += 1.0;
            }
        }
        Seen { pixels, width, truth: sums.iter().map(|(sum, count)| sum / count).collect() }
    }

    fn at(&self, column: usize, row: usize) -> f64 {
        f64::from(self.pixels[row * self.width + column])
    }

    /// Row of the brightest place of a column within `reach` rows around one.
    fn peak(&self, column: usize, around: f64, reach: f64) -> f64 {
        let rows = (around - reach).round() as usize..=(around + reach).round() as usize;
        let best = rows.max_by(|a, b| self.at(column, *a).total_cmp(&self.at(column, *b))).unwrap();
        let [a, b, c] = [best - 1, best, best + 1].map(|row| self.at(column, row));
        best as f64 + if a - 2.0 * b + c < 0.0 { 0.5 * (a - c) / (a - 2.0 * b + c) } else { 0.0 }
    }

    /// Does a column have a layer of its own so far below the surface: within a row a local maximum, 5 dB above what lies
    /// four rows above and below it?
    fn has_layer(&self, column: usize, below_m: f64) -> bool {
        let wanted = self.truth[column] + below_m / BIN_M;
        let place = self.peak(column, wanted, 2.0);
        let row = place.round() as usize;
        let beside = self.at(column, row - 4).max(self.at(column, row + 4));
        // Grey from 40 to 100 dB.
        (place - wanted).abs() <= 1.0 && self.at(column, row) - beside > 5.0 * 255.0 / 60.0
    }

    /// Part of the columns with a layer so far below the surface.
    fn part(&self, below_m: f64) -> f64 {
        (0..self.width).filter(|column| self.has_layer(*column, below_m)).count() as f64 / self.width as f64
    }

    fn judge(&self, what: &str) {
        let surface = |column| self.peak(column, self.truth[column], 5.0) - self.truth[column];
        let rms = ((0..self.width).map(|c| surface(c).powi(2)).sum::<f64>() / self.width as f64).sqrt();
        let there = LAYERS_M.map(|below_m| self.part(below_m));
        let absent = NO_LAYERS_M.map(|below_m| self.part(below_m));
        println!(
            "{what}: surface rms {rms:.3} rows, layers in {there:.3?}, none in {absent:.3?} of the columns"
        );
        assert!(rms <= 1.0, "{what}: surface rows off by {rms:.2} rms");
        assert!(there.iter().all(|part| *part >= 0.99), "{what}: layers in {there:.3?} of the columns");
        assert!(absent.iter().all(|part| *part <= 0.01), "{what}: layers that are not, in {absent:.3?}");
    }
}

#[test]
fn the_image_shows_surface_and_layers_where_they_are_and_none_where_there_is_none() {
    for world in ["no_membrane", "static_no_membrane"] {
        Seen::of(Setup::new(world, 7)).judge(world);
    }
    Seen::of(Setup::from_the_side("no_membrane", 7)).judge("from the side");
    for seed in seeds() {
        let setup = Setup { end_m: -1.2e-3, ..Setup::new("no_membrane", seed) };
        Seen::of(setup).judge(&format!("seed {seed}"));
    }
}

/// A scan that has set off, begun from within the line. Its columns are a tenth as wide as where a tip counts as at the begin.
fn fine_scan() -> Rig {
    let place_m = [-1.45e-3, 0.0, 500e-6];
    let mut rig = Rig::new(Setup { images: true, place_m, ..Setup::new("static_no_membrane", 2) });
    rig.steps(60);
    let request = ScanRequest { to: [FINE_END_M, 0.0, APEX_Z_M], pitch: 1.5e-6, ..Rig::request() };
    rig.bench.command::<ScanRequest, ()>("scan/start", request).unwrap();
    rig.until_scanning();
    rig
}

/// Where it ends along x, m, and of how many columns it is.
const FINE_END_M: f64 = -1.4e-3;
const FINE: usize = 67;

/// Goes on until the tip is so far before the end of a fine scan, m.
fn until_left(rig: &mut Rig, left_m: f64) {
    while rig.truth.last().unwrap().x_m < FINE_END_M - left_m {
        rig.step();
    }
    assert_eq!(rig.progress().phase, Phase::SCAN);
}

#[test]
fn a_tip_that_comes_from_within_the_line_leaves_no_column_out() {
    let mut rig = fine_scan();
    rig.until_idle();
    let columns: Vec<u32> = rig.bench.outputs::<ScanColumn>("column").iter().map(|c| c.column).collect();
    assert!(columns.iter().copied().eq(0..FINE as u32), "{columns:?}");
}

#[test]
fn a_scan_waits_at_its_end_for_a_scans_that_are_late() {
    let mut rig = fine_scan();
    // What is taken in its last 5 ms comes 20 ms later.
    until_left(&mut rig, 2.5e-6);
    rig.setup.latency_ns = 20_000_000;
    rig.until_idle();
    let columns = rig.bench.outputs::<ScanColumn>("column");
    assert!(columns.iter().map(|c| c.column as usize).eq(0..FINE), "{columns:?}");
    // 3 ms of 4 kHz each, but for what the tip's speed makes of them.
    assert!(columns[FINE - 2..].iter().all(|c| c.lines >= 10), "{:?}", &columns[FINE - 2..]);
    let beyond_m = rig.truth.iter().map(|t| t.x_m - FINE_END_M).fold(0.0, f64::max);
    assert!(beyond_m < 10e-6, "the tip waits at the end, not {beyond_m} m beyond it");
}

#[test]
fn a_scan_whose_a_scans_stay_away_waits_at_its_end_no_longer_than_they_may_be_late() {
    let mut rig = fine_scan();
    until_left(&mut rig, 2.5e-6);
    rig.bench.connect_input("ascan", false);
    until_left(&mut rig, 0.0);
    rig.steps(25);
    assert_eq!(rig.progress().phase, Phase::SCAN);
    rig.steps(10);
    assert_eq!(rig.progress().phase, Phase::RETRACT);
}

#[test]
fn an_oct_that_falls_silent_right_before_the_end_does_not_end_the_scan_before_its_end() {
    let mut rig = fine_scan();
    until_left(&mut rig, 5e-6);
    ["ascan", "distance"].iter().for_each(|input| rig.bench.connect_input(input, false));
    rig.until_idle();
    assert!(rig.bench.events::<Text<128>>("scan/bscan_aborted").is_empty());
    let done = rig.bench.events::<ScanDone>("scan/bscan_done");
    assert_eq!((done.len(), done[0].columns as usize), (1, FINE), "{done:?}");
}

#[test]
fn columns_tell_where_the_tip_and_the_surface_were_when_their_first_a_scan_was_taken_however_late_it_came() {
    let setup = Setup { images: true, latency_ns: 9_000_000, end_m: -1.3e-3, ..Setup::new("no_membrane", 2) };
    let mut rig = Rig::run(setup);
    let columns = rig.bench.outputs::<ScanColumn>("column");
    assert!(columns.len() >= 30, "{}", columns.len());
    for column in &columns {
        let truth = rig.truth.iter().find(|t| t.ns == column.stamp.ns()).expect("the A-scan's own time");
        assert_eq!(column.pose.stamp, column.stamp);
        let [x, _, z] = column.pose.position;
        // 9 ms of delay are 4.5 µm of way; encoders have steps of 0.5 µm.
        assert!((x - truth.x_m).abs() < 0.6e-6, "{:.2e} m beside", x - truth.x_m);
        assert!((z - 0.121 - truth.tip_z_m).abs() < 0.6e-6, "{:.2e} m above", z - 0.121 - truth.tip_z_m);
        // What was seen in this very A-scan, and so is no nearer to any other one's.
        assert_eq!(column.distance, truth.measured.distance);
        let off_m = column.distance - truth.distance_m;
        assert!(off_m.abs() < 1e-6, "column {}: {off_m:.2e} m off the truth", column.column);
    }
}

#[test]
fn images_grow_with_the_scan_have_the_time_of_their_newest_a_scan_and_come_with_news_alone() {
    let setup = Setup { images: true, end_m: -1.1e-3, ..Setup::new("no_membrane", 2) };
    let mut rig = Rig::new(setup);
    rig.begin();
    rig.until_scanning();
    rig.steps(300);
    let images = rig.bench.frames::<ImageHeader>("bscan_image");
    assert!((4..=6).contains(&images.len()), "{} images in 0.3 s", images.len());
    for (header, _, stamp) in &images {
        assert_eq!(header.stamp, *stamp);
        assert!(rig.truth.iter().any(|t| t.ns == stamp.ns()), "the time of an exposure");
    }
    // The distances go on, the A-scans do not.
    rig.bench.connect_input("ascan", false);
    rig.steps(100);
    assert!(rig.bench.frames::<ImageHeader>("bscan_image").len() <= 1, "what had come before");
    rig.steps(60);
    assert!(rig.bench.frames::<ImageHeader>("bscan_image").is_empty(), "the OCT is silent");
    let last = images.last().unwrap().0.stamp;
    rig.until_idle();
    let (whole, ..) = rig.bench.frames::<ImageHeader>("bscan_image").pop().unwrap();
    let age_s = whole.stamp.seconds_since(last);
    assert!((0.0..0.08).contains(&age_s), "the whole image is as old as its newest A-scan: {age_s} s");
}

#[test]
fn without_a_scans_there_is_no_image() {
    let mut rig = Rig::run(Setup { end_m: -1.4e-3, ..Setup::new("static_no_membrane", 2) });
    assert!(rig.bench.frames::<ImageHeader>("bscan_image").is_empty());
}

#[test]
fn a_scans_with_times_that_cannot_be_belong_nowhere_and_break_nothing() {
    let mut rig = Rig::new(Setup::new("default", 1));
    rig.begin();
    rig.until_scanning();
    while rig.truth.last().unwrap().x_m < -1.499e-3 {
        rig.step();
    }
    let header = AScanHeader {
        stamp: rig.bench.now(),
        lines: 2,
        samples: 8,
        format: SampleFormat::F32,
        line_period: 1.0,
        ..AScanHeader::default()
    };
    for (stamp, line_period) in [
        (header.stamp, f64::INFINITY),
        (header.stamp, f64::NAN),
        (header.stamp, -1.0),
        (header.stamp, 1e300),
        (Stamp::from_ns(u64::MAX), 1.0),
        (Stamp::INVALID, 250e-6),
    ] {
        rig.bench.push_frame("ascan", AScanHeader { stamp, line_period, ..header }, &[0; 64]);
        rig.step();
    }
    assert_eq!(rig.progress().phase, Phase::SCAN);
    assert!(rig.progress().columns <= 1, "{:?}", rig.progress());
}

#[test]
fn frames_that_are_no_a_scans_are_counted() {
    let mut bench = Bench::<BScan>::new("{}");
    let header = |format, lines, samples| {
        let stamp = Stamp::from_ns(1_000);
        AScanHeader { stamp, lines, samples, format, ..AScanHeader::default() }
    };
    let bad = [
        header(SampleFormat::U8, 3, 4),
        header(SampleFormat::U16, 1, 4),
        header(SampleFormat::U8, u32::MAX, u32::MAX),
        AScanHeader { line_period: f64::NAN, ..header(SampleFormat::U8, 2, 4) },
        // Its second A-scan is still to come.
        AScanHeader { stamp: bench.now(), line_period: 0.01, ..header(SampleFormat::U8, 2, 4) },
    ];
    for header in bad {
        bench.push_frame("ascan", header, &[7; 8]);
    }
    bench.push_frame(
        "ascan",
        AScanHeader { stamp: Stamp::INVALID, ..header(SampleFormat::U8, 2, 4) },
        &[7; 8],
    );
    bench.push_frame("ascan", header(SampleFormat::U8, 2, 4), &[7; 8]);
    bench.step(1);
    assert_eq!(bench.state().refused_frames, bad.len() as u64 + 1, "all but the last one");
}

#[test]
fn a_running_scan_allocates_nothing() {
    let mut rig = Rig::new(Setup { images: true, ..Setup::new("default", 1) });
    rig.begin();
    rig.until_scanning();
    rig.watched = true;
    rig.steps(300);
}

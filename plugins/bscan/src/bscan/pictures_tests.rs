//! The image of a scan against the phantom's truth (gate A7), its columns, and frames that are no A-scans.
#![allow(clippy::unwrap_used)]

use trocar_sdk::data::{AScanHeader, ImageHeader, PixelFormat, SampleFormat};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use crate::rig::{APEX_Z_M, Rig, Setup, seeds};
use crate::{BScan, Flatten, Phase, ScanColumn, ScanDone, ScanRequest};

/// Depths of the phantom's inner layers below its surface, and depths without any, m of optical path.
const INNER_M: [f64; 2] = [35e-6, 90e-6];
const NONE_M: [f64; 2] = [62e-6, 140e-6];
/// Distances from its pigment epithelium, up and down, without any.
const ABOVE_M: f64 = 55e-6;
const UNDER_M: f64 = 60e-6;
/// From the surface to the epithelium, beside pit and vessels.
const EPITHELIUM_M: f64 = 240e-6;
/// The inner layers end in the pit: they are looked for as far from its middle as this.
const PIT_M: f64 = 0.75e-3;
const BIN_M: f64 = 3.5117e-6;

/// An image of a scan, and where its columns have surface and pigment epithelium in truth, in rows.
struct Seen {
    pixels: Vec<u8>,
    width: usize,
    truth: Vec<Column>,
}

/// The truth of a column.
#[derive(Clone, Copy, Default)]
struct Column {
    /// Along the line from the pit, m.
    x_m: f64,
    surface: f64,
    epithelium: f64,
    count: f64,
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
        let mut truth = vec![Column::default(); width];
        for t in rig.truth.iter().filter(|t| t.scanning && t.x_m >= from_m) {
            if let Some(column) = truth.get_mut(((t.x_m - from_m) / pitch_m) as usize) {
                let part = 1.0 / (column.count + 1.0);
                column.count += 1.0;
                for (mean, new) in [
                    (&mut column.x_m, t.x_m / rig.part_across()),
                    (&mut column.surface, t.ilm_m * 1.336 / BIN_M),
                    (&mut column.epithelium, t.epithelium_m * 1.336 / BIN_M),
                ] {
                    *mean += part * (new - *mean);
                }
            }
        }
        Seen { pixels, width, truth }
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

    /// Does a column have a layer of its own at a row: within one of it a local maximum, 5 dB above what lies
    /// four rows above and below it?
    fn has_layer(&self, column: usize, wanted: f64) -> bool {
        let place = self.peak(column, wanted, 2.0);
        let row = place.round() as usize;
        let beside = self.at(column, row - 4).max(self.at(column, row + 4));
        // Grey from 40 to 100 dB.
        (place - wanted).abs() <= 1.0 && self.at(column, row) - beside > 5.0 * 255.0 / 60.0
    }

    /// Part of the columns with a layer at the row that `row` says; `None` leaves a column out.
    fn part(&self, row: impl Fn(&Column) -> Option<f64>) -> f64 {
        let rows = self.truth.iter().enumerate().filter_map(|(column, truth)| Some((column, row(truth)?)));
        let (there, all) = rows.fold((0, 0), |(there, all), (column, row)| {
            (there + usize::from(self.has_layer(column, row)), all + 1)
        });
        f64::from(there as u32) / f64::from(all)
    }

    fn judge(&self, what: &str) {
        let surface =
            |column| self.peak(column, self.truth[column].surface, 5.0) - self.truth[column].surface;
        let rms = ((0..self.width).map(|c| surface(c).powi(2)).sum::<f64>() / self.width as f64).sqrt();
        let beside_pit = |column: &Column, row: f64| (column.x_m.abs() > PIT_M).then_some(row);
        let below_surface =
            |below_m: f64| self.part(|column| beside_pit(column, column.surface + below_m / BIN_M));
        let epithelium = self.part(|column| Some(column.epithelium));
        let above = self.part(|column| beside_pit(column, column.epithelium - ABOVE_M / BIN_M));
        let under = self.part(|column| Some(column.epithelium + UNDER_M / BIN_M));
        let ([one, two], [a, b]) = (INNER_M.map(below_surface), NONE_M.map(below_surface));
        let (there, absent) = ([one, two, epithelium], [a, b, above, under]);
        println!(
            "{what}: surface rms {rms:.3} rows, layers in {there:.3?}, none in {absent:.3?} of the columns"
        );
        assert!(rms <= 1.0, "{what}: surface rows off by {rms:.2} rms");
        assert!(there.iter().all(|part| *part >= 0.99), "{what}: layers in {there:.3?} of the columns");
        assert!(absent.iter().all(|part| *part <= 0.01), "{what}: layers that are not, in {absent:.3?}");
        // The truth itself: the epithelium lies as deep as it is said to, and goes straight on below the pit.
        let thick = |column: &Column| (column.epithelium - column.surface) * BIN_M;
        let beside: Vec<f64> = self.truth.iter().filter(|c| c.x_m.abs() > 1.2e-3).map(thick).collect();
        assert!(
            beside.iter().all(|thick_m| (0.0..30e-6).contains(&(thick_m - EPITHELIUM_M + 2e-6))),
            "{what}: {beside:?} m thick beside pit and vessels"
        );
        if let Some(middle) = self.truth.iter().find(|column| column.x_m.abs() < 10e-6) {
            assert!(thick(middle) < 0.55 * EPITHELIUM_M, "{what}: {} m thick in the pit", thick(middle));
        }
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

#[test]
fn laid_straight_the_image_shows_the_surface_as_far_above_the_epithelium_as_it_is() {
    for seed in seeds() {
        let seen = Seen::of(Setup::from_the_side("default", seed));
        let header = ImageHeader {
            stamp: Stamp::from_ns(1),
            width: seen.width as u32,
            height: 512,
            stride: seen.width as u32,
            format: PixelFormat::GRAY8,
            index: 0,
        };
        let mut bench = Bench::<Flatten>::new("{}");
        bench.push_frame("image", header, &seen.pixels);
        bench.step(1);
        let (header, pixels, _) = bench.frames::<ImageHeader>("flattened").pop().unwrap();
        assert_eq!((header.width as usize, header.height), (seen.width, 305));
        let flat = Seen { pixels, ..seen };
        let mut off = [0.0; 2];
        let mut wild = 0;
        for (column, truth) in flat.truth.iter().enumerate() {
            let surface = 175.0 - (truth.epithelium - truth.surface);
            let by = [flat.peak(column, 175.0, 5.0) - 175.0, flat.peak(column, surface, 5.0) - surface];
            off.iter_mut().zip(by).for_each(|(sum, by)| *sum += by * by / flat.width as f64);
            wild += usize::from(by.iter().any(|by| by.abs() > 3.0));
        }
        let rms = off.map(f64::sqrt);
        println!("seed {seed}: epithelium and surface {rms:.2?} rows off, {wild} columns by more than three");
        // A row is 3.5 µm; over its own height the epithelium is speckled.
        assert!(rms.iter().all(|rms| *rms < 1.5) && wild * 50 < flat.width, "seed {seed}: {rms:.2?}, {wild}");
    }
}

/// A scan that has set off, begun from within the line. Its columns are a tenth as wide as the range in which
/// a tip counts as at the begin.
fn fine_scan() -> Rig {
    let place_m = [-1.45e-3, 0.0, 500e-6];
    let mut rig = Rig::new(Setup { images: true, place_m, ..Setup::new("static_no_membrane", 2) });
    rig.steps(60);
    let request = ScanRequest { to: [FINE_END_M, 0.0, APEX_Z_M], pitch: 1.5e-6, ..Rig::request() };
    rig.bench.command::<ScanRequest, ()>("scan/start", request).unwrap();
    rig.until_scanning();
    rig
}

/// Its end along x, m, and its number of columns.
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
    // A-scans taken in its last 5 ms come 20 ms later.
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
        // The distance is that of this very A-scan, and so is no nearer to any other one's.
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

//! The component `plot`: numbers of whatever is connected, over time, as a picture when it is asked for one.
//!
//! Invariant: a step reads numbers at known places into rings that are there; what is drawn is a copy.

use trocar_sdk::prelude::*;

use crate::chart::{self, Chart, Curve};
use crate::file::{self, SaveRequest, SavedPicture};
use crate::saving::Saving;
use crate::traces::{Point, Trace};

/// Why there is nothing to draw.
const NOTHING: &str =
    "no number has come yet: connect `a`, `b`, `c` or `d`, start what sends them, and ask again";

/// Names of the inputs.
const INPUTS: [&str; 4] = ["a", "b", "c", "d"];

#[derive(Config)]
struct PlotConfig {
    /// Place of the number in the samples of `a`, `b`, `c`, `d`, as `position/2`; "" or nothing where the
    /// samples are numbers
    #[config(default = [])]
    fields: Vec<String>,
    /// Place of a flag beside it that is false while the number means nothing (a gap); "" or nothing where
    /// there is none
    #[config(default = [])]
    valid: Vec<String>,
    /// Numbers taken from those of `a`, `b`, `c`, `d` first; 0 where nothing is said
    #[config(live, default = [])]
    offsets: Vec<f64>,
    /// Factors of the rest, 1e6 to see metres as micrometres; 1 where nothing is said
    #[config(live, default = [])]
    scales: Vec<f64>,
    /// Names of the curves in the legend; nothing: as the inputs
    #[config(live, default = [])]
    labels: Vec<String>,
    /// Points that are kept of each curve; the oldest give way
    #[config(min = 2, max = 1_000_000, default = 100_000)]
    keep: usize,
    /// Length of the past that is drawn; 0 for all that is kept
    #[config(live, min = 0.0, max = 1e6, unit = "s", default = 0.0)]
    window_s: f64,
    /// Above the picture
    #[config(live, default = "")]
    title: String,
    /// Beside the vertical axis, with its unit
    #[config(live, default = "")]
    y_label: String,
    /// Lower end of the vertical axis; none: the curves decide
    #[config(live, default = None)]
    y_min: Option<f64>,
    /// Upper end
    #[config(live, default = None)]
    y_max: Option<f64>,
    /// Width of the picture
    #[config(live, min = 320, max = 4096, unit = "px", default = 1200)]
    width: u32,
    /// Height of the picture
    #[config(live, min = 240, max = 4096, unit = "px", default = 600)]
    height: u32,
}

/// Draws curves of what comes in to a PNG file when asked to. The time axis begins with the first point that
/// is drawn.
#[derive(Component)]
#[component(model = "on_signal", provides("ctl"), max_step_ms = 10_000)]
pub struct Plot {
    /// Samples, or frames, with a number in them
    #[input(optional, fifo = 256)]
    a: AnyIn,
    /// As `a`
    #[input(optional, fifo = 256)]
    b: AnyIn,
    /// As `a`
    #[input(optional, fifo = 256)]
    c: AnyIn,
    /// As `a`
    #[input(optional, fifo = 256)]
    d: AnyIn,
    /// The samples of an input lack the number, or the flag, that is configured for it: what to set. Once per
    /// connection.
    #[event("ctl")]
    unplaced: Event<Text<160>>,
    /// Points taken since Start.
    #[state]
    samples: u64,
    /// Samples left out since Start: no number at that place, no stamp, or back in time.
    #[state]
    rejected: u64,
    /// Files written since Start.
    #[state]
    saved: u64,
    #[config]
    cfg: PlotConfig,
    #[host]
    host: Host,
    traces: Vec<Series>,
    saving: Saving,
}

/// One curve while it grows.
#[derive(Default)]
struct Series {
    trace: Trace,
    /// The connection the last sample came by, and where the number is in what comes by it.
    source: u64,
    place: Option<Place>,
    /// And where the flag is.
    valid: Option<Place>,
    /// Sentences for a missing number and for a missing flag.
    missing: [Text<160>; 2],
}

impl Series {
    /// The number in a sample; none where there is no place for it.
    fn read(&self, sample: &[u8]) -> Option<f64> {
        let value = self.place?.number(sample)?;
        let valid = self.valid.is_none_or(|flag| flag.number(sample) != Some(0.0));
        Some(if valid { value } else { f64::NAN })
    }

    /// Finds the places in what comes by another connection, and says what is not there.
    fn connected(
        &mut self,
        (field, valid): (&str, &str),
        place: impl Fn(&str) -> Option<Place>,
        unplaced: &Event<Text<160>>,
    ) {
        self.place = place(field);
        self.valid = if valid.is_empty() { None } else { place(valid) };
        if self.place.is_none() {
            unplaced.emit(self.missing[0]);
        }
        if self.valid.is_none() && !valid.is_empty() {
            unplaced.emit(self.missing[1]);
        }
    }

    /// Samples come, and have no number at the place that is configured.
    fn is_unplaced(&self) -> bool {
        self.source != 0 && self.place.is_none()
    }
}

#[provides("ctl")]
impl Plot {
    /// Draws what is there to a new file, and answers when that is written.
    #[command]
    fn save(&mut self, request: &SaveRequest) -> Result<SavedPicture> {
        let path = file::named(&request.path)?;
        let Some(chart) = chart_of(&self.cfg, &self.traces) else {
            let unplaced = self.traces.iter().find(|series| series.is_unplaced());
            return Err(unplaced.map_or(NOTHING, |series| &series.missing[0]).into());
        };
        let newest_ns = self.traces.iter().filter_map(|s| s.trace.newest()).map(|point| point.at_ns).max();
        let age = newest_ns.map_or(0.0, |ns| self.host.now().seconds_since(Stamp::from_ns(ns)));
        let name = self.host.instance_name().rsplit('/').next().unwrap_or_default();
        let saved = self.saving.run(name, move || file::write(&path, &chart::draw(&chart)?))?;
        self.saved += 1;
        Ok(SavedPicture { age, ..saved })
    }

    /// Forgets all points.
    #[command]
    fn clear(&mut self) {
        self.traces.iter_mut().for_each(|series| series.trace.clear());
    }
}

/// A copy of what is to be drawn.
fn chart_of(cfg: &PlotConfig, traces: &[Series]) -> Option<Chart> {
    let newest_ns =
        traces.iter().filter_map(|series| series.trace.newest()).map(|point| point.at_ns).max()?;
    let from_ns = match (cfg.window_s * 1e9) as u64 {
        0 => 0,
        window_ns => newest_ns.saturating_sub(window_ns),
    };
    let drawn = |series: &Series| series.trace.iter().filter(|p| p.at_ns >= from_ns).collect::<Vec<Point>>();
    let traces: Vec<Vec<Point>> = traces.iter().map(drawn).collect();
    let begin_ns = traces.iter().filter_map(|points| points.first()).map(|point| point.at_ns).min()?;
    // An input that is used has a curve or a label; the others are not spoken of.
    let used = |(n, points): &(usize, Vec<Point>)| !points.is_empty() || *n < cfg.labels.len();
    let curves = traces.into_iter().enumerate().filter(used).map(|(n, points)| {
        let (offset, scale) = (of(&cfg.offsets, n, 0.0), of(&cfg.scales, n, 1.0));
        let at = |p: Point| ((p.at_ns - begin_ns) as f64 * 1e-9, (p.value - offset) * scale);
        let label = cfg.labels.get(n).map_or(INPUTS[n % 4], String::as_str).to_owned();
        Curve { label, points: points.into_iter().map(at).collect() }
    });
    Some(Chart {
        title: cfg.title.clone(),
        y_label: cfg.y_label.clone(),
        width: cfg.width,
        height: cfg.height,
        y_min: cfg.y_min,
        y_max: cfg.y_max,
        curves: curves.collect(),
    })
}

fn of(list: &[f64], n: usize, other: f64) -> f64 {
    list.get(n).copied().unwrap_or(other)
}

impl PlotConfig {
    /// Paths of the number of an input, and of the flag beside it.
    fn places(&self, n: usize) -> (&str, &str) {
        (self.fields.get(n).map_or("", String::as_str), self.valid.get(n).map_or("", String::as_str))
    }

    fn check(&self) -> Result {
        let lists = [
            ("fields", self.fields.len()),
            ("valid", self.valid.len()),
            ("offsets", self.offsets.len()),
            ("scales", self.scales.len()),
            ("labels", self.labels.len()),
        ];
        if let Some((key, len)) = lists.into_iter().find(|(_, len)| *len > INPUTS.len()) {
            return Err(format!("{key}: {len} are too many: there are the inputs a, b, c and d").into());
        }
        for (key, list) in [("offsets", &self.offsets), ("scales", &self.scales)] {
            if let Some(bad) = list.iter().find(|v| !v.is_finite()) {
                return Err(format!("{key}: {bad} is not finite: give a number").into());
            }
        }
        if let (Some(low), Some(high)) = (self.y_min, self.y_max)
            && (low.is_nan() || high.is_nan() || low >= high)
        {
            return Err(
                format!("y_min, y_max: {low} is not below {high}: swap them, or leave one out").into()
            );
        }
        Ok(())
    }
}

impl Component for Plot {
    fn configure(&mut self) -> Result {
        self.cfg.check()?;
        let keep = self.cfg.keep;
        if self.traces.len() != INPUTS.len() || self.traces.iter().any(|s| !s.trace.keeps(keep)) {
            let series = || Series { trace: Trace::new(keep), ..Series::default() };
            self.traces = INPUTS.iter().map(|_| series()).collect();
        }
        // Places may be others now: they are found again with the next sample.
        for (n, series) in self.traces.iter_mut().enumerate() {
            let (input, (field, valid)) = (INPUTS[n], self.cfg.places(n));
            series.source = 0;
            series.missing = [
                format!("{input}: there is no number at \"{field}\" in what is connected; set `fields`"),
                format!("{input}: there is no flag at \"{valid}\" in what is connected; set `valid`"),
            ]
            .map(|told| Text::new(&told));
        }
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.samples, self.rejected, self.saved) = (0, 0, 0);
        self.clear();
        Ok(())
    }

    fn stop(&mut self) -> Result {
        self.saving = Saving::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let inputs = [&mut self.a, &mut self.b, &mut self.c, &mut self.d];
        for (n, (input, series)) in inputs.into_iter().zip(&mut self.traces).enumerate() {
            while let Some(sample) = input.next() {
                let (stamp, source) = (sample.stamp(), sample.source());
                if source != series.source {
                    series.source = source;
                    series.connected(self.cfg.places(n), |path| sample.place(path), &self.unplaced);
                }
                let value = series.read(sample.value());
                let taken = stamp.is_valid()
                    && value.is_some_and(|value| series.trace.push(Point { at_ns: stamp.ns(), value }));
                self.samples += u64::from(taken);
                self.rejected += u64::from(!taken);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "plot_tests.rs"]
mod tests;

//! From a line to a record: the values of all outputs, one after the other, filled in from the columns or the
//! JSON of the line.
//!
//! Invariant: any bytes are a line: what cannot be taken is a sentence, and a record is used only when its
//! line was taken whole.

use trocar_sdk::prelude::*;
use trocar_sdk::serde_json::{self, Value as Json};

use crate::clock;
use crate::described::{Described, Kind};
use crate::values::{put, put_json, shown, split};

/// Most outputs.
const OUTPUTS: usize = 64;

/// The form of lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Format {
    Numbers,
    Json,
}

/// The way from lines to records.
pub(crate) struct Plan {
    format: Format,
    pub(crate) outputs: Vec<Described>,
    /// The begin of each in a record.
    pub(crate) begins: Vec<usize>,
    pub(crate) blank: Vec<u8>,
    values: Vec<Value>,
    /// Numbers of a line.
    columns: usize,
    time: Option<Time>,
}

/// The device's own time.
struct Time {
    from: From,
    unit_s: f64,
}

struct Value {
    at: usize,
    kind: Kind,
    from: From,
    n: Option<usize>,
}

enum From {
    /// The first of them, from 0.
    Column(usize),
    /// Keys, from the object under the output's name where there is one, else from the line's own.
    Below(String, Vec<String>),
    /// Keys, from the line's own object.
    Path(Vec<String>),
}

/// A line that is not bad.
#[derive(Debug, PartialEq)]
pub(crate) enum Line {
    /// A record was filled; with the device's own time, s.
    Record(Option<f64>),
    /// Nothing in it, or a comment.
    Nothing,
}

impl Plan {
    /// `stamp`: "arrival", or a field and its unit; `columns`: how many each line has, 0: as many as are
    /// taken.
    ///
    /// # Errors
    /// A sentence that names the setting.
    pub(crate) fn of(outputs: &[String], format: Format, stamp: &str, columns: usize) -> Result<Plan> {
        if outputs.is_empty() || outputs.len() > OUTPUTS {
            let many = outputs.len();
            return Err(format!(
                "outputs: there are {many}, and 1 to {OUTPUTS} are possible; such as [\"force: fx N, fy N\"]"
            )
            .into());
        }
        let outputs = outputs.iter().map(|text| Described::read(text)).collect::<Result<Vec<_>>>()?;
        let time = Time::read(stamp, format)?;
        let reserved = match &time {
            Some(Time { from: From::Column(at), .. }) => Some(*at),
            _ => None,
        };
        let (mut next, mut last) = (0, reserved.map_or(0, |at| at + 1));
        let (mut begins, mut blank, mut values) = (Vec::new(), Vec::new(), Vec::new());
        for output in &outputs {
            let begin = blank.len();
            begins.push(begin);
            blank.extend_from_slice(&output.blank);
            for (i, part) in output.parts.iter().enumerate() {
                let first = output.from.as_ref().filter(|_| i == 0 && format == Format::Numbers);
                let from = match (format, part.from.as_ref().or(first)) {
                    (Format::Numbers, given) => {
                        if let Some(given) = given {
                            next = column(given)?;
                        }
                        let n = part.n.unwrap_or(1);
                        if let Some(stamp) = reserved.filter(|at| (next..next + n).contains(at))
                            && given.is_none()
                        {
                            next = stamp + 1;
                        }
                        let first = next;
                        next += n;
                        last = last.max(next);
                        From::Column(first)
                    }
                    (Format::Json, Some(path)) => From::Path(keys(path)),
                    (Format::Json, None) if output.from.is_some() => {
                        let object = output.from.as_deref().unwrap_or_default();
                        From::Path(keys(&format!("{object}.{}", part.name)))
                    }
                    (Format::Json, None) if part.name.is_empty() => From::Path(vec![output.name.clone()]),
                    (Format::Json, None) => From::Below(output.name.clone(), vec![part.name.clone()]),
                };
                values.push(Value { at: begin + part.at, kind: part.kind, from, n: part.n });
            }
        }
        if format == Format::Numbers && columns != 0 && columns < last {
            return Err(format!(
                "columns: {columns} numbers in a line are too few, the outputs and the stamp take {last}: give 0 or as many as \
                 there are"
            )
            .into());
        }
        let columns = if columns == 0 { last } else { columns };
        Ok(Plan { format, outputs, begins, blank, values, columns, time })
    }

    /// Reads a line, without its end. `record` has the size of `blank`.
    ///
    /// # Errors
    /// Why it cannot be taken, for people.
    pub(crate) fn read(&self, line: &[u8], record: &mut [u8]) -> Result<Line, String> {
        let text = match std::str::from_utf8(line) {
            Ok(text) => text.trim(),
            Err(why) => return Err(format!("not text: byte {} is not valid UTF-8", why.valid_up_to() + 1)),
        };
        if let Some(at) = text.bytes().position(|byte| byte < b' ' && byte != b'\t') {
            return Err(format!("not text: byte {} is a control character", at + 1));
        }
        if text.is_empty() || text.starts_with('#') {
            return Ok(Line::Nothing);
        }
        record.copy_from_slice(&self.blank);
        match self.format {
            Format::Numbers => self.numbers(text, record),
            Format::Json => self.json(text, record),
        }
    }

    fn numbers(&self, text: &str, record: &mut [u8]) -> Result<Line, String> {
        let cells = split(text);
        if cells.len() != self.columns {
            return Err(format!("{} in it, {} wanted", plural(cells.len()), plural(self.columns)));
        }
        let cell = |at: usize| cells.get(at).copied().unwrap_or_default();
        let take = |at: usize, kind: Kind, to: &mut [u8]| {
            put(kind, cell(at), to).map_err(|why| format!("column {}: {why}", at + 1))
        };
        for value in &self.values {
            let From::Column(first) = value.from else { continue };
            let size = value.kind.size();
            for i in 0..value.n.unwrap_or(1) {
                take(first + i, value.kind, room(record, value.at + i * size, size))?;
            }
        }
        let Some(Time { from: From::Column(at), unit_s }) = &self.time else { return Ok(Line::Record(None)) };
        let mut bytes = [0; 8];
        take(*at, Kind::F64, &mut bytes)?;
        timed(&bytes, *unit_s)
    }

    fn json(&self, text: &str, record: &mut [u8]) -> Result<Line, String> {
        let line: Json = serde_json::from_str(text).map_err(|why| format!("not valid JSON: {why}"))?;
        if !line.is_object() {
            return Err("not a JSON object: write {\"name\": value}".into());
        }
        for value in &self.values {
            let (found, path) = value.from.find(&line)?;
            let size = value.kind.size();
            let wrong = |why: String| format!("{path}: {why}");
            let Some(n) = value.n else {
                put_json(value.kind, found, room(record, value.at, size)).map_err(wrong)?;
                continue;
            };
            let items = found.as_array().filter(|items| items.len() == n);
            let items = items.ok_or_else(|| wrong(format!("{} is not a list of {n} items", shown(found))))?;
            for (i, item) in items.iter().enumerate() {
                put_json(value.kind, item, room(record, value.at + i * size, size)).map_err(wrong)?;
            }
        }
        let Some(Time { from, unit_s }) = &self.time else { return Ok(Line::Record(None)) };
        let (found, path) = from.find(&line)?;
        let mut bytes = [0; 8];
        put_json(Kind::F64, found, &mut bytes).map_err(|why| format!("{path}: {why}"))?;
        timed(&bytes, *unit_s)
    }
}

impl Time {
    fn read(stamp: &str, format: Format) -> Result<Option<Time>> {
        if matches!(stamp.trim(), "" | "arrival") {
            return Ok(None);
        }
        let wrong = |why: &str| {
            format!("stamp: {stamp:?}: {why}; write \"arrival\", or a field and its unit, such as \"t ms\"")
        };
        let words: Vec<&str> = stamp.split_whitespace().collect();
        let [field, unit] = words[..] else { return Err(wrong("not a field and a unit").into()) };
        let unit_s = match unit {
            "s" => 1.0,
            "ms" => 1e-3,
            "us" | "µs" => 1e-6,
            "ns" => 1e-9,
            _ => return Err(wrong("the unit is not one of s, ms, us, ns").into()),
        };
        let from = match format {
            Format::Numbers => From::Column(column(field).map_err(|why| wrong(&why.to_string()))?),
            Format::Json => From::Path(keys(field)),
        };
        Ok(Some(Time { from, unit_s }))
    }
}

impl From {
    /// The value there, and its name for people.
    fn find<'a>(&self, line: &'a Json) -> Result<(&'a Json, String), String> {
        let (from, keys) = match self {
            From::Below(name, keys) => {
                (line.get(name).filter(|inner| inner.is_object()).unwrap_or(line), keys)
            }
            From::Path(keys) => (line, keys),
            From::Column(_) => (line, const { &Vec::new() }),
        };
        let mut found = from;
        for key in keys {
            let next = match found {
                Json::Array(items) => key.parse::<usize>().ok().and_then(|at| items.get(at)),
                other => other.get(key),
            };
            found = next.ok_or_else(|| format!("there is no {:?} in it", keys.join(".")))?;
        }
        Ok((found, keys.join(".")))
    }
}

fn keys(path: &str) -> Vec<String> {
    path.split('.').map(str::to_owned).collect()
}

/// A record with the device's own time.
fn timed(bytes: &[u8; 8], unit_s: f64) -> Result<Line, String> {
    let time_s = f64::from_le_bytes(*bytes) * unit_s;
    if !clock::is_time(time_s) {
        return Err(format!("the time {time_s:e} s is more than 146 years from 0"));
    }
    Ok(Line::Record(Some(time_s)))
}

/// Counted from 1 by people.
fn column(text: &str) -> Result<usize> {
    match text.parse::<usize>() {
        Ok(n @ 1..=4096) => Ok(n - 1),
        _ => Err(format!("{text:?} is not a column: they are counted from 1").into()),
    }
}

fn plural(n: usize) -> String {
    format!("{n} value{}", if n == 1 { "" } else { "s" })
}

fn room(record: &mut [u8], at: usize, size: usize) -> &mut [u8] {
    record.get_mut(at..at + size).unwrap_or_default()
}

#[cfg(test)]
#[path = "plan_tests.rs"]
mod tests;

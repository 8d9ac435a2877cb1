//! Messages as arrays of NumPy, a file of all of them.
//!
//! Invariant: an array has a row for each message of its topic; memory is taken only within [`Bounds`].

use std::collections::BTreeMap;
use std::path::Path;

use super::columns::Cell;
use super::npz::{Item, Npz};
use super::pictures;
use super::planes::{Plane, Row};
use super::sink::{Bounds, ExportView, Message, Sink, incomplete, new_file, wrote};
use crate::failure::Failure;

pub(super) struct Arrays {
    topics: BTreeMap<String, Columns>,
    /// Bounds of the memory that the arrays may take, and the bytes they take, B.
    bounds: Bounds,
    bytes: usize,
}

impl Arrays {
    pub(super) fn new(bounds: Bounds) -> Arrays {
        Arrays { topics: BTreeMap::new(), bounds, bytes: 0 }
    }
}

/// The messages of one topic, by columns.
#[derive(Default)]
struct Columns {
    times: [Vec<u8>; 3],
    rows: usize,
    /// Items of 8 bytes.
    fields: BTreeMap<String, (Item, Vec<u8>)>,
    /// Bytes of frames, in rows of the first one's shape.
    planes: BTreeMap<String, Plane>,
}

impl Columns {
    /// Bytes that a frame takes, and whether it is as the first.
    fn room_for(&self, name: &str, plane: &Plane) -> (usize, bool) {
        let first = self.planes.get(name).unwrap_or(plane);
        let fits = (first.item, &first.shape) == (plane.item, &plane.shape);
        // Neither a row nor the number of rows is larger than bytes that were there once.
        let row = first.shape.iter().product::<usize>() * first.item.bytes();
        (if fits { plane.bytes.len() } else { row.saturating_mul(plane.rows) }, fits)
    }

    /// Adds the rows of a frame. A frame of another shape than the first becomes as many rows of zeros: rows
    /// stay with their times.
    fn add_plane(&mut self, name: String, plane: Plane) {
        let (more, fits) = self.room_for(&name, &plane);
        let first = self.planes.entry(name).or_insert_with(|| Plane {
            rows: 0,
            shape: plane.shape.clone(),
            bytes: Vec::new(),
            item: plane.item,
        });
        first.bytes.extend_from_slice(if fits { &plane.bytes } else { &[] });
        first.bytes.resize(first.bytes.len() + if fits { 0 } else { more }, 0);
        first.rows += plane.rows;
    }

    /// Bytes that a value in a row takes, with the gap before it.
    fn room_in(&self, name: &str, row: usize) -> usize {
        let there = self.fields.get(name).map(|(_, values)| values.len());
        (8 * row + 8).saturating_sub(there.unwrap_or(0)) + if there.is_none() { name.len() } else { 0 }
    }

    /// Adds a value; tells whether it has a place.
    fn add(&mut self, name: String, item: Item, bits: [u8; 8], row: usize) -> bool {
        let (kind, values) = self.fields.entry(name).or_insert((item, Vec::new()));
        // A message without the field leaves a gap: not a number, or zero.
        let gap = if *kind == Item::F64 { f64::NAN.to_le_bytes() } else { [0; 8] };
        while values.len() < 8 * row {
            values.extend_from_slice(&gap);
        }
        let placed = values.len() == 8 * row && *kind == item;
        if placed {
            values.extend_from_slice(&bits);
        }
        placed
    }
}

impl Sink for Arrays {
    fn take(&mut self, message: &Message<'_>, view: &mut ExportView) -> Result<(), Failure> {
        let Some(cells) = message.row(view) else { return Ok(()) };
        let Message { channel, header, .. } = *message;
        let columns = self.topics.entry(channel.topic.trim_matches('/').to_owned()).or_default();
        let row = columns.rows;
        columns.times[0].extend_from_slice(&header.log_time.to_le_bytes());
        columns.times[1].extend_from_slice(&header.publish_time.to_le_bytes());
        columns.times[2].extend_from_slice(&u64::from(header.sequence).to_le_bytes());
        columns.rows += 1;
        self.bytes += 24;
        let is_picture = pictures::is_one(&channel.schema.name, &Row(&cells));
        view.pictures += u64::from(is_picture);
        let planes = cells.iter().filter_map(|(name, cell)| match cell {
            Cell::Bytes(bytes) if !is_picture => Some((name.clone(), Plane::of(&Row(&cells), name, bytes))),
            _ => None,
        });
        for (name, plane) in planes.collect::<Vec<_>>() {
            let (more, fits) = columns.room_for(&name, &plane);
            self.bytes = self.bounds.memory(self.bytes.saturating_add(more))?;
            columns.add_plane(name, plane);
            view.unplaced += u64::from(!fits);
        }
        for (name, cell) in cells {
            let (item, bits) = match cell {
                Cell::Float(n) => (Item::F64, n.to_le_bytes()),
                Cell::Whole(n) | Cell::Named(n, _) => (Item::I64, n.to_le_bytes()),
                Cell::Large(n) => (Item::U64, n.to_le_bytes()),
                Cell::Text(_) => {
                    view.texts += 1;
                    continue;
                }
                // Bytes were placed above.
                Cell::Bytes(_) => continue,
            };
            self.bytes = self.bounds.memory(self.bytes.saturating_add(columns.room_in(&name, row)))?;
            view.unplaced += u64::from(!columns.add(name, item, bits, row));
        }
        view.messages += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>, output: &Path, view: &mut ExportView) -> Result<u64, Failure> {
        let mut npz = Npz::new(new_file(output)?);
        let failed = |e: std::io::Error| incomplete(wrote(output, &e), output);
        for (topic, columns) in &mut self.topics {
            let rows = columns.rows;
            let heads = ["log_time_ns", "publish_time_ns", "sequence"].into_iter().zip(&columns.times);
            // The field of that name, if the type has one.
            for (name, times) in heads.filter(|(name, _)| !columns.fields.contains_key(*name)) {
                npz.array(&format!("{topic}/{name}"), Item::U64, &[rows], times).map_err(failed)?;
            }
            for (name, plane) in &columns.planes {
                let shape: Vec<usize> = [plane.rows].into_iter().chain(plane.shape.iter().copied()).collect();
                npz.array(&format!("{topic}/{name}"), plane.item, &shape, &plane.bytes).map_err(failed)?;
            }
            let mut groups: BTreeMap<String, Vec<(usize, String)>> = BTreeMap::new();
            for name in columns.fields.keys() {
                let (base, index) = indexed(name);
                groups.entry(base).or_default().push((index.unwrap_or(0), name.clone()));
            }
            for (base, mut members) in groups {
                members.sort_unstable();
                let kinds: Vec<Item> =
                    members.iter().filter_map(|(_, n)| columns.fields.get(n).map(|f| f.0)).collect();
                let one_kind = kinds.windows(2).all(|pair| pair[0] == pair[1]);
                let (true, Some(kind)) = (one_kind, kinds.first().copied()) else {
                    view.unplaced += (rows * members.len()) as u64;
                    continue;
                };
                let gap = if kind == Item::F64 { f64::NAN.to_le_bytes() } else { [0; 8] };
                // Fields that came late or seldom are filled up here, which is counted, too.
                let more = 8usize.saturating_mul(rows).saturating_mul(members.len());
                self.bounds.memory(self.bytes.saturating_add(more))?;
                let mut bytes = Vec::with_capacity(more);
                for row in 0..rows {
                    for (_, name) in &members {
                        let values = columns.fields.get(name).map_or(&[][..], |f| &f.1[..]);
                        bytes.extend_from_slice(values.get(8 * row..8 * row + 8).unwrap_or(&gap));
                    }
                }
                let shape = [rows, members.len()];
                let shape = if members.len() == 1 { &shape[..1] } else { &shape[..] };
                npz.array(&format!("{topic}/{base}"), kind, shape, &bytes).map_err(failed)?;
            }
        }
        npz.finish().map_err(failed)?;
        Ok(1)
    }
}

/// `position[2]` → `position` and 2; deeper indexes stay in the name.
fn indexed(name: &str) -> (String, Option<usize>) {
    let parts = name.strip_suffix(']').and_then(|rest| rest.rsplit_once('['));
    match parts.and_then(|(base, index)| Some((base, index.parse().ok()?))) {
        Some((base, index)) => (base.to_owned(), Some(index)),
        None => (name.to_owned(), None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_of_another_shape_is_zeros_so_that_rows_stay_with_their_times() {
        let mut columns = Columns::default();
        let mut add = |rows: usize, side: usize| {
            let plane = Plane { item: Item::U16, rows, shape: vec![side], bytes: vec![7; 2 * rows * side] };
            let room = columns.room_for("data", &plane);
            columns.add_plane("data".into(), plane);
            room
        };
        assert_eq!((add(3, 2), add(1, 5), add(2, 2)), ((12, true), (4, false), (8, true)));
        let data = &columns.planes["data"];
        assert_eq!((data.rows, &data.shape[..]), (6, &[2][..]));
        assert_eq!(data.bytes, [&[7; 12][..], &[0; 4], &[7; 8]].concat());
    }

    #[test]
    fn items_of_a_list_stand_side_by_side() {
        assert_eq!(indexed("pose.position[2]"), ("pose.position".to_owned(), Some(2)));
        assert_eq!(indexed("joints[1].effort"), ("joints[1].effort".to_owned(), None));
        assert_eq!(indexed("odd]"), ("odd]".to_owned(), None));
    }
}

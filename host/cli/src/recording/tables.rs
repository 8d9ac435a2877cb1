//! A table of comma-separated values for each topic: a row of names, then a line for each message.
//!
//! Invariant: however many topics there are, one file is open at a time. The bytes that wait for it are
//! bounded by [`WAITS`] for each topic, and by [`WAIT`] for all.

use std::collections::{BTreeMap, HashMap};
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::columns::Cell;
use super::sink::{Bounds, ExportView, Message, Names, Sink, new_file, wrote};
use crate::failure::Failure;

/// Bytes of a table that are written at once.
const WAITS: usize = 64 << 10;
/// Bytes of all tables that wait together.
const WAIT: usize = 32 << 20;

pub(super) struct Tables {
    directory: PathBuf,
    /// By channel.
    all: BTreeMap<u16, Table>,
    files: Names,
    bounds: Bounds,
    /// Bytes that wait, those of all names of columns, and those of all that there is.
    waiting: usize,
    names: usize,
    written: u64,
}

struct Table {
    path: PathBuf,
    names: Vec<String>,
    waits: Vec<u8>,
}

impl Tables {
    pub(super) fn new(directory: PathBuf, bounds: Bounds) -> Tables {
        let (all, files) = (BTreeMap::new(), Names::default());
        Tables { directory, all, files, bounds, waiting: 0, names: 0, written: 0 }
    }

    /// Makes the file of a channel with these columns.
    fn begin(&mut self, channel: u16, topic: &str, names: Vec<String>) -> Result<(), Failure> {
        let bytes =
            |names: &[String]| names.iter().map(|name| name.len() + size_of::<String>()).sum::<usize>();
        self.names = self.bounds.memory(self.names + bytes(&names))?;
        let path = self.directory.join(format!("{}.csv", self.files.free(topic)));
        new_file(&path)?;
        let heads: Vec<String> = names.iter().map(|name| Cell::Text(name.clone()).text()).collect();
        let waits = format!("log_time_ns,publish_time_ns,sequence,{}\n", heads.join(",")).into_bytes();
        let more = waits.len();
        self.all.insert(channel, Table { path, names, waits });
        self.waits(more)
    }

    /// Counts more bytes that wait; writes all where they are too many.
    fn waits(&mut self, more: usize) -> Result<(), Failure> {
        self.written = self.bounds.written(self.written + more as u64)?;
        self.waiting += more;
        if self.waiting > WAIT {
            self.all.values_mut().try_for_each(Table::write)?;
            self.waiting = 0;
        }
        Ok(())
    }
}

impl Table {
    /// Writes a cell for each column; returns how many of the row's there were.
    fn line(&self, row: &[(String, Cell)], line: &mut String) -> usize {
        let mut placed = 0;
        // Made where a message is not as the first one of its topic.
        let mut by_name: Option<HashMap<&str, &Cell>> = None;
        for (n, name) in self.names.iter().enumerate() {
            let same = row.get(n).filter(|(other, _)| other == name).map(|(_, cell)| cell);
            let cell = same.or_else(|| {
                let all = || row.iter().rev().map(|(name, cell)| (name.as_str(), cell)).collect();
                by_name.get_or_insert_with(all).get(name.as_str()).copied()
            });
            line.push(',');
            if let Some(cell) = cell {
                line.push_str(&cell.text());
                placed += 1;
            }
        }
        line.push('\n');
        placed
    }

    fn write(&mut self) -> Result<(), Failure> {
        if self.waits.is_empty() {
            return Ok(());
        }
        let write = |path: &Path| OpenOptions::new().append(true).open(path)?.write_all(&self.waits);
        write(&self.path).map_err(|e| wrote(&self.path, &e))?;
        self.waits.clear();
        Ok(())
    }
}

impl Sink for Tables {
    fn take(&mut self, message: &Message<'_>, view: &mut ExportView) -> Result<(), Failure> {
        let Some(row) = message.row(view) else { return Ok(()) };
        let Message { channel, header, .. } = *message;
        if !self.all.contains_key(&header.channel_id) {
            let names = row.iter().map(|(name, _)| name.clone()).collect();
            self.begin(header.channel_id, &channel.topic, names)?;
        }
        let Some(table) = self.all.get_mut(&header.channel_id) else { return Ok(()) };
        let mut line = format!("{},{},{}", header.log_time, header.publish_time, header.sequence);
        let placed = table.line(&row, &mut line);
        view.unplaced += (row.len() - placed.min(row.len())) as u64;
        view.messages += 1;
        table.waits.extend_from_slice(line.as_bytes());
        if table.waits.len() >= WAITS {
            self.waiting = self.waiting.saturating_sub(table.waits.len());
            table.write()?;
        }
        self.waits(line.len())
    }

    fn finish(mut self: Box<Self>, _: &Path, _: &mut ExportView) -> Result<u64, Failure> {
        self.all.values_mut().try_for_each(Table::write)?;
        Ok(self.all.len() as u64)
    }
}

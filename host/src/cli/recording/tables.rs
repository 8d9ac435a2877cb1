//! A table of comma-separated values for each topic: a row of names, then a line for each message.
//!
//! Invariant: however many topics there are, one file is open at a time; what waits for it is bounded by [`WAITS`] for each.

use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::columns::Cell;
use super::sink::{ExportView, Message, Sink, free_name, new_file, wrote};
use crate::cli::failure::Failure;

/// Bytes of a table that are written at once.
const WAITS: usize = 64 << 10;

pub(super) struct Tables {
    directory: PathBuf,
    /// By channel.
    all: BTreeMap<u16, Table>,
}

struct Table {
    path: PathBuf,
    names: Vec<String>,
    waits: Vec<u8>,
}

impl Tables {
    pub(super) fn new(directory: PathBuf) -> Tables {
        Tables { directory, all: BTreeMap::new() }
    }

    /// Makes the file of a channel with these columns.
    fn begin(&mut self, channel: u16, topic: &str, names: Vec<String>) -> Result<(), Failure> {
        let is_of = |table: &Table, name: &str| table.path.file_stem().is_some_and(|stem| *stem == *name);
        let name = free_name(topic, |name| self.all.values().any(|table| is_of(table, name)));
        let path = self.directory.join(format!("{name}.csv"));
        new_file(&path)?;
        let heads: Vec<String> = names.iter().map(|name| Cell::Text(name.clone()).text()).collect();
        let waits = format!("log_time_ns,publish_time_ns,sequence,{}\n", heads.join(",")).into_bytes();
        self.all.insert(channel, Table { path, names, waits });
        Ok(())
    }
}

impl Table {
    fn write(&mut self) -> Result<(), Failure> {
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
        let mut placed = 0;
        for (n, name) in table.names.iter().enumerate() {
            let same = row.get(n).filter(|(other, _)| other == name);
            let cell = same.or_else(|| row.iter().find(|(other, _)| other == name));
            line.push(',');
            if let Some((_, cell)) = cell {
                line.push_str(&cell.text());
                placed += 1;
            }
        }
        line.push('\n');
        view.unplaced += (row.len() - placed.min(row.len())) as u64;
        view.messages += 1;
        table.waits.extend_from_slice(line.as_bytes());
        if table.waits.len() < WAITS { Ok(()) } else { table.write() }
    }

    fn finish(mut self: Box<Self>, _: &Path, _: &mut ExportView) -> Result<u64, Failure> {
        self.all.values_mut().try_for_each(Table::write)?;
        Ok(self.all.len() as u64)
    }
}

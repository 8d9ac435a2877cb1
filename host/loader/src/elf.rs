//! Reads from the bytes of an ELF file the facts that must be known before the dynamic linker may see it.
//!
//! Invariant: no byte is trusted. Every offset is checked before use, nothing panics, allocates by a number
//! from the file, or loops without a bound that the file's length gives.

use super::Fault;

/// Facts the loader asks about a library.
#[derive(Debug, Default)]
pub(crate) struct Elf<'a> {
    /// The manifest: descriptor of the `.note.trocar` note.
    pub note: Option<&'a [u8]>,
    /// Libraries by DT_NEEDED, in order.
    pub needed: Vec<&'a str>,
    /// DT_RPATH: for itself and for the needs of the libraries it needs.
    pub rpaths: Vec<&'a str>,
    /// DT_RUNPATH: for itself alone; then DT_RPATH does not count.
    pub runpaths: Vec<&'a str>,
    /// Names `_Unwind_RaiseException`: it can unwind a panic.
    pub unwinds: bool,
    /// The first symbol with binding STB_GNU_UNIQUE that is not of the C++ library.
    pub unique_symbol: Option<&'a str>,
}

#[cfg(target_arch = "x86_64")]
const OWN_MACHINE: u16 = 62;
#[cfg(target_arch = "aarch64")]
const OWN_MACHINE: u16 = 183;

const PT_LOAD: u32 = 1;
const PT_DYNAMIC: u32 = 2;
const PT_INTERP: u32 = 3;
const PT_NOTE: u32 = 4;
const SHT_NOBITS: u32 = 8;
const SHT_DYNSYM: u32 = 11;
const DT_NEEDED: u64 = 1;
const DT_STRTAB: u64 = 5;
const DT_STRSZ: u64 = 10;
const DT_RPATH: u64 = 15;
const DT_RUNPATH: u64 = 29;
const DT_FLAGS_1: u64 = 0x6fff_fffb;
const DF_1_PIE: u64 = 0x0800_0000;
const STB_GNU_UNIQUE: u8 = 10;
const SYMBOL_SIZE: usize = 24;
const SECTION_SIZE: usize = 64;
const SEGMENT_SIZE: usize = 56;

/// Bounds that no honest library reaches and that keep a hostile one from costing time.
const MAX_SECTIONS: u64 = 65_535;
const MAX_NEEDED: usize = 512;
const MAX_NOTE_SEGMENTS: usize = 16;
const MAX_NOTES: usize = 64;
/// Longest name read from a string table, bytes.
const MAX_NAME: usize = 4096;

/// The machine of this host, in words.
pub(crate) fn own_machine() -> &'static str {
    machine_name(OWN_MACHINE).unwrap_or("unknown")
}

fn machine_name(machine: u16) -> Option<&'static str> {
    Some(match machine {
        2 | 18 | 43 => "SPARC",
        3 => "32-bit x86",
        8 => "MIPS",
        20 => "32-bit PowerPC",
        21 => "64-bit PowerPC",
        22 => "s390x",
        40 => "32-bit ARM",
        62 => "x86-64",
        183 => "aarch64",
        243 => "RISC-V",
        258 => "LoongArch",
        _ => return None,
    })
}

impl<'a> Elf<'a> {
    /// # Errors
    /// The first thing that makes the file no loadable shared library of this machine.
    pub(crate) fn parse(bytes: &'a [u8]) -> Result<Elf<'a>, Fault> {
        let file = File(bytes);
        file.check_identity()?;
        let segments = file.segments()?;
        let sections = file.sections()?;
        for (i, segment) in segments.iter().enumerate() {
            file.check_segment(i, segment)?;
        }
        let mut elf = Elf::default();
        let mut flags_1 = 0;
        if let Some(dynamic) = segments.iter().find(|s| s.kind == PT_DYNAMIC) {
            flags_1 = elf.read_dynamic(file, dynamic, &segments)?;
        }
        let has_interpreter = segments.iter().any(|s| s.kind == PT_INTERP);
        elf.note = find_note(file, &segments, &sections)?;
        match file.u16(16).unwrap_or(0) {
            3 if flags_1 & DF_1_PIE != 0 || (has_interpreter && elf.note.is_none()) => {
                return Err(Fault::Executable);
            }
            3 => {}
            2 => return Err(Fault::Executable),
            1 => return Err(Fault::NotALibrary { kind: "an object file" }),
            4 => return Err(Fault::NotALibrary { kind: "a core dump" }),
            _ => return Err(Fault::NotALibrary { kind: "an ELF file of unknown type" }),
        }
        if !segments.iter().any(|s| s.kind == PT_LOAD) || !segments.iter().any(|s| s.kind == PT_DYNAMIC) {
            return Err(malformed("it has nothing to load"));
        }
        elf.unique_symbol = unique_symbol(file, &sections);
        Ok(elf)
    }

    /// Returns a warning about symbols that all versions of the library share.
    pub(crate) fn unique_warning(&self) -> Option<String> {
        let symbol = self.unique_symbol?;
        Some(format!(
            "exports unique symbols (`{symbol}`), which all its versions would share: build it with \
             -fvisibility=hidden, or with g++ -fno-gnu-unique; it cannot be unloaded"
        ))
    }

    /// Reads the dynamic section and returns its DT_FLAGS_1.
    fn read_dynamic(
        &mut self,
        file: File<'a>,
        dynamic: &Segment,
        segments: &[Segment],
    ) -> Result<u64, Fault> {
        let entries = file.range(dynamic.offset, dynamic.file_size).unwrap_or_default();
        let entries = entries
            .as_chunks::<16>()
            .0
            .iter()
            .map(|e| (le64(&e[..8]), le64(&e[8..])))
            .take_while(|(tag, _)| *tag != 0);
        let (mut flags_1, mut table, mut size) = (0, None, 0);
        for (tag, value) in entries.clone() {
            match tag {
                DT_FLAGS_1 => flags_1 = value,
                DT_STRTAB => table = Some(value),
                DT_STRSZ => size = value,
                _ => {}
            }
        }
        let Some(table) = table else { return Ok(flags_1) };
        let at = segments
            .iter()
            .filter(|s| s.kind == PT_LOAD)
            .find_map(|s| table.checked_sub(s.address).filter(|d| *d < s.file_size).map(|d| s.offset + d))
            .ok_or_else(|| malformed("its string table lies in no segment"))?;
        let strings = file.range(at, size).ok_or_else(|| malformed("its string table leaves the file"))?;
        for (tag, value) in entries {
            let list = match tag {
                DT_NEEDED => &mut self.needed,
                DT_RPATH => &mut self.rpaths,
                DT_RUNPATH => &mut self.runpaths,
                _ => continue,
            };
            if list.len() == MAX_NEEDED {
                return Err(malformed("it needs too many libraries"));
            }
            list.push(
                text_at(strings, value)
                    .ok_or_else(|| malformed("the name of a needed library is not readable"))?,
            );
        }
        self.unwinds = contains(strings, b"_Unwind_RaiseException\0");
        Ok(flags_1)
    }
}

struct Segment {
    kind: u32,
    offset: u64,
    address: u64,
    file_size: u64,
    memory_size: u64,
}

struct Section<'a> {
    name: &'a [u8],
    kind: u32,
    link: u32,
    offset: u64,
    size: u64,
}

/// Checked little-endian reads.
#[derive(Clone, Copy)]
struct File<'a>(&'a [u8]);

impl<'a> File<'a> {
    fn range(self, offset: u64, size: u64) -> Option<&'a [u8]> {
        let start = usize::try_from(offset).ok()?;
        let end = start.checked_add(usize::try_from(size).ok()?)?;
        self.0.get(start..end)
    }

    fn array<const N: usize>(self, at: usize) -> Option<[u8; N]> {
        self.0.get(at..at.checked_add(N)?)?.try_into().ok()
    }

    fn u16(self, at: usize) -> Option<u16> {
        self.array(at).map(u16::from_le_bytes)
    }

    fn u32(self, at: usize) -> Option<u32> {
        self.array(at).map(u32::from_le_bytes)
    }

    fn u64(self, at: usize) -> Option<u64> {
        self.array(at).map(u64::from_le_bytes)
    }

    fn truncated(self, what: impl Into<String>, needs: u64) -> Fault {
        Fault::Truncated { what: what.into(), needs, has: self.0.len() as u64 }
    }

    fn check_identity(self) -> Result<(), Fault> {
        if self.0.is_empty() {
            return Err(Fault::Empty);
        }
        let magic = b"\x7fELF";
        if !self.0.starts_with(magic) {
            let head = &self.0[..self.0.len().min(512)];
            let cut = magic.starts_with(head);
            let text =
                !cut && head.iter().all(|b| matches!(b, b'\t' | b'\n' | b'\r' | 0x1b | 0x20..=0x7e | 0x80..));
            return Err(if cut { self.truncated("the ELF header", 64) } else { Fault::NotElf { text } });
        }
        if self.0.len() < 64 {
            return Err(self.truncated("the ELF header", 64));
        }
        let big_endian = self.0[5] == 2;
        let raw = [self.0[18], self.0[19]];
        let machine = if big_endian { u16::from_be_bytes(raw) } else { u16::from_le_bytes(raw) };
        if big_endian || self.0[4] != 2 || machine != OWN_MACHINE {
            let name = machine_name(machine).map_or_else(|| format!("machine {machine}"), str::to_string);
            let order = if big_endian { " (big-endian)" } else { "" };
            let width = if machine == OWN_MACHINE && self.0[4] == 1 { " with 32-bit pointers" } else { "" };
            if order.is_empty() && width.is_empty() && machine == OWN_MACHINE {
                return Err(malformed("its class is neither 32 nor 64 bit"));
            }
            return Err(Fault::WrongMachine {
                built_for: format!("{name}{order}{width}"),
                host: own_machine(),
            });
        }
        if self.0[6] != 1 || self.0[5] != 1 || self.u32(20) != Some(1) {
            return Err(malformed("its version is unknown"));
        }
        Ok(())
    }

    /// The bytes of a table of `count` entries, or where it would have to end.
    fn table(self, what: &str, offset: u64, count: u64, size: usize) -> Result<&'a [u8], Fault> {
        let bytes = count.saturating_mul(size as u64);
        self.range(offset, bytes).ok_or_else(|| self.truncated(what, offset.saturating_add(bytes)))
    }

    fn segments(self) -> Result<Vec<Segment>, Fault> {
        let (offset, size, count) = (self.u64(32), self.u16(54), self.u16(56));
        let (Some(offset), Some(size), Some(count)) = (offset, size, count) else {
            return Err(self.truncated("the ELF header", 64));
        };
        if count == 0 {
            return Ok(Vec::new());
        }
        if usize::from(size) != SEGMENT_SIZE {
            return Err(malformed("its program headers have an unknown size"));
        }
        let table = self.table("the program header table", offset, count.into(), SEGMENT_SIZE)?;
        let read = |e: &[u8; SEGMENT_SIZE]| Segment {
            kind: le32(&e[0..4]),
            offset: le64(&e[8..16]),
            address: le64(&e[16..24]),
            file_size: le64(&e[32..40]),
            memory_size: le64(&e[40..48]),
        };
        Ok(table.as_chunks::<SEGMENT_SIZE>().0.iter().map(read).collect())
    }

    fn check_segment(self, i: usize, s: &Segment) -> Result<(), Fault> {
        if !matches!(s.kind, PT_LOAD | PT_DYNAMIC | PT_NOTE | PT_INTERP | 7) {
            return Ok(());
        }
        if self.range(s.offset, s.file_size).is_none() {
            return Err(self.truncated(format!("segment {i}"), s.offset.saturating_add(s.file_size)));
        }
        let in_memory = s.memory_size >= s.file_size && s.address.checked_add(s.memory_size).is_some();
        if matches!(s.kind, PT_LOAD | 7) && !in_memory {
            return Err(malformed(format!("segment {i} does not fit into memory")));
        }
        Ok(())
    }

    /// All sections; a file without a section table has none, a table outside the file is a truncation.
    fn sections(self) -> Result<Vec<Section<'a>>, Fault> {
        let offset = self.u64(40).unwrap_or(0);
        if offset == 0 {
            return Ok(Vec::new());
        }
        let first = self.table("the section header table", offset, 1, SECTION_SIZE)?;
        let count = match self.u16(60) {
            Some(0) => le64(&first[32..40]),
            count => u64::from(count.unwrap_or(0)),
        };
        if count > MAX_SECTIONS {
            return Err(malformed("it has too many sections"));
        }
        if self.u16(58).map(usize::from) != Some(SECTION_SIZE) {
            return Err(malformed("its section headers have an unknown size"));
        }
        let table = self.table("the section header table", offset, count, SECTION_SIZE)?;
        let table = table.as_chunks::<SECTION_SIZE>().0;
        let names_index = match self.u16(62) {
            Some(0xffff) => le32(&first[40..44]) as usize,
            index => usize::from(index.unwrap_or(0)),
        };
        let extent = |e: &[u8; SECTION_SIZE]| (le64(&e[24..32]), le64(&e[32..40]));
        let names = table.get(names_index).map(extent).and_then(|(at, size)| self.range(at, size));
        let mut sections = Vec::with_capacity(table.len());
        for (i, e) in table.iter().enumerate() {
            let kind = le32(&e[4..8]);
            let (offset, size) = extent(e);
            if i > 0 && kind != SHT_NOBITS && kind != 0 && self.range(offset, size).is_none() {
                return Err(self.truncated(format!("section {i}"), offset.saturating_add(size)));
            }
            let name = text_at(names.unwrap_or_default(), le32(&e[0..4]).into()).unwrap_or_default();
            sections.push(Section { name: name.as_bytes(), kind, link: le32(&e[40..44]), offset, size });
        }
        Ok(sections)
    }
}

/// The manifest note from the PT_NOTE segments, else from the section of its name.
fn find_note<'a>(
    file: File<'a>,
    segments: &[Segment],
    sections: &[Section<'a>],
) -> Result<Option<&'a [u8]>, Fault> {
    let mut found = Vec::new();
    for s in segments.iter().filter(|s| s.kind == PT_NOTE).take(MAX_NOTE_SEGMENTS) {
        collect_notes(file.range(s.offset, s.file_size).unwrap_or_default(), &mut found);
    }
    if found.is_empty() {
        let name = trocar_plugin_api::note::SECTION.as_bytes();
        for s in sections.iter().filter(|s| s.name == name && s.kind != SHT_NOBITS).take(1) {
            collect_notes(file.range(s.offset, s.size).unwrap_or_default(), &mut found);
        }
    }
    found.sort_by_key(|note| note.as_ptr());
    found.dedup_by_key(|note| note.as_ptr());
    match found.len() {
        0 | 1 => Ok(found.first().copied()),
        n => Err(Fault::BadManifest {
            because: format!("it carries {n} manifests; two plugins cannot be linked into one library"),
        }),
    }
}

/// Walks notes of 4-byte alignment (8-byte ones are property notes, never ours).
fn collect_notes<'a>(bytes: &'a [u8], found: &mut Vec<&'a [u8]>) {
    use trocar_plugin_api::note::{OWNER, TYPE_MANIFEST};
    let file = File(bytes);
    let mut at = 0usize;
    for _ in 0..MAX_NOTES {
        let (Some(name_size), Some(desc_size), Some(kind)) =
            (file.u32(at), file.u32(at.saturating_add(4)), file.u32(at.saturating_add(8)))
        else {
            return;
        };
        let name_at = at as u64 + 12;
        let desc_at = name_at + u64::from(name_size).next_multiple_of(4);
        let (Some(name), Some(desc)) =
            (file.range(name_at, name_size.into()), file.range(desc_at, desc_size.into()))
        else {
            return;
        };
        if name == OWNER && kind == TYPE_MANIFEST {
            found.push(desc);
        }
        at = (desc_at + u64::from(desc_size).next_multiple_of(4)) as usize;
    }
}

fn unique_symbol<'a>(file: File<'a>, sections: &[Section<'a>]) -> Option<&'a str> {
    let table = sections.iter().find(|s| s.kind == SHT_DYNSYM)?;
    let strings = sections.get(table.link as usize)?;
    let strings = file.range(strings.offset, strings.size)?;
    let symbols = file.range(table.offset, table.size)?.as_chunks::<SYMBOL_SIZE>().0;
    let unique = symbols.iter().filter(|s| s[4] >> 4 == STB_GNU_UNIQUE);
    unique.filter_map(|s| text_at(strings, le32(&s[0..4]).into())).find(|name| !is_of_std(name))
}

/// A constant or guard of namespace `std`, mangled: the same in every version of a plugin, and no flag of its
/// build hides it.
fn is_of_std(symbol: &str) -> bool {
    let name = symbol.strip_prefix("_ZGV").or_else(|| symbol.strip_prefix("_Z")).unwrap_or("");
    let name = name.trim_start_matches(['Z', 'N', 'K']);
    name.starts_with("St") || name.starts_with("9__gnu_cxx")
}

fn text_at(strings: &[u8], at: u64) -> Option<&str> {
    let rest = strings.get(usize::try_from(at).ok()?..)?;
    let end = rest.iter().take(MAX_NAME).position(|b| *b == 0)?;
    std::str::from_utf8(&rest[..end]).ok()
}

fn contains(haystack: &[u8], needle: &[u8]) -> bool {
    haystack.windows(needle.len()).any(|w| w == needle)
}

/// `bytes` has at least 4; shorter input reads as 0.
fn le32(bytes: &[u8]) -> u32 {
    File(bytes).u32(0).unwrap_or(0)
}

fn le64(bytes: &[u8]) -> u64 {
    File(bytes).u64(0).unwrap_or(0)
}

fn malformed(what: impl Into<String>) -> Fault {
    Fault::Malformed { what: what.into() }
}

#[cfg(test)]
#[path = "elf_tests.rs"]
mod tests;

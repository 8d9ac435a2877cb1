//! The memory both ends of a link share: a block on the heap of one process, or a memfd mapped by two. The
//! same algorithms work in both.
//!
//! Invariant: only values for which any bits are valid lie here ([`Plain`]), since another process can write
//! them; an end keeps to itself all it relies on (lengths, offsets, its own positions). Both ends lay out the
//! same parts in the same order.

use std::io;
use std::ops::Deref;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::sync::Arc;

use crate::buf::{ALIGN, AlignedBuf};
use crate::mapping::{Mapping, Writers};
use crate::sync::{AtomicU32, AtomicU64, Futex, Padded, Scope, Shared};

/// A block of zeroed memory for the parts of one link.
pub struct Region {
    memory: Memory,
    #[cfg(loom)]
    parts: std::sync::Mutex<Parts>,
}

/// Loom's atomics cannot lie at any place: the parts of a region are kept by where they would begin, so that
/// both ends find the same ones.
#[cfg(loom)]
type Parts = std::collections::BTreeMap<usize, Arc<dyn std::any::Any>>;

// SAFETY: what the parts are used for is what the models check.
#[cfg(loom)]
unsafe impl Send for Region {}
// SAFETY: as above.
#[cfg(loom)]
unsafe impl Sync for Region {}

enum Memory {
    Heap(AlignedBuf),
    Mapped(Mapping),
}

impl Region {
    pub(crate) fn heap(bytes: usize) -> Arc<Self> {
        Self::of(Memory::Heap(AlignedBuf::new(bytes)))
    }

    /// Makes memory another process can be given: [`Region::fd`].
    ///
    /// # Errors
    /// The machine has not that much memory.
    pub fn shared(bytes: usize) -> io::Result<Arc<Self>> {
        Ok(Self::of(Memory::Mapped(Mapping::create("a link", bytes.max(1), Writers::BothEnds)?)))
    }

    /// Opens memory that another process made and handed over, of `bytes` bytes.
    ///
    /// # Errors
    /// It has not that size, or could be made smaller later.
    pub fn open(fd: OwnedFd, bytes: usize) -> io::Result<Arc<Self>> {
        Ok(Self::of(Memory::Mapped(Mapping::open(fd, bytes.max(1), Writers::BothEnds)?)))
    }

    /// Makes memory another process can be given to look at, and that no other process ever writes.
    ///
    /// # Errors
    /// The machine has not that much memory.
    pub fn shown(bytes: usize) -> io::Result<Arc<Self>> {
        Ok(Self::of(Memory::Mapped(Mapping::create("rows for others", bytes.max(1), Writers::Maker)?)))
    }

    /// Opens memory of [`Region::shown`] that another process made. Its parts may be loaded here, never
    /// stored to.
    ///
    /// # Errors
    /// It has not that size, could be made smaller later, or takes other writers.
    pub(crate) fn look(fd: OwnedFd, bytes: usize) -> io::Result<Arc<Self>> {
        Ok(Self::of(Memory::Mapped(Mapping::open(fd, bytes.max(1), Writers::Maker)?)))
    }

    fn of(memory: Memory) -> Arc<Self> {
        Arc::new(Self {
            memory,
            #[cfg(loom)]
            parts: Default::default(),
        })
    }

    /// Returns the values that begin at `at`, made by the end that asks first.
    #[cfg(loom)]
    fn part<T: 'static>(&self, at: usize, make: impl FnOnce() -> Box<[T]>) -> Arc<Box<[T]>> {
        let mut parts = self.parts.lock().expect("no model panics in here");
        let part = parts.entry(at).or_insert_with(|| Arc::new(make()) as Arc<dyn std::any::Any>);
        let part = Arc::clone(part);
        // `Arc<dyn Any>` without Send goes back to its type by address.
        assert!((*part).is::<Box<[T]>>(), "both ends lay out the same parts");
        // SAFETY: the type was just checked.
        unsafe { Arc::from_raw(Arc::into_raw(part).cast::<Box<[T]>>()) }
    }

    /// Returns the descriptor for another process; `None` on the heap.
    pub fn fd(&self) -> Option<BorrowedFd<'_>> {
        match &self.memory {
            Memory::Heap(_) => None,
            Memory::Mapped(mapping) => Some(mapping.fd()),
        }
    }

    pub(crate) fn scope(&self) -> Scope {
        match &self.memory {
            Memory::Heap(_) => Scope::Process,
            Memory::Mapped(_) => Scope::Machine,
        }
    }

    pub(crate) fn at(&self, offset: usize) -> *mut u8 {
        match &self.memory {
            Memory::Heap(buf) => buf.at(offset),
            Memory::Mapped(mapping) => mapping.at(offset),
        }
    }
}

/// A type that may lie in a region: any bits are a value, and nothing is to be dropped.
///
/// # Safety
/// As said, for atomics also where another process writes them at any time.
pub(crate) unsafe trait Plain: 'static {}

// SAFETY: an atomic number has no invalid bits.
unsafe impl Plain for AtomicU32 {}
// SAFETY: as above.
unsafe impl Plain for AtomicU64 {}
// SAFETY: one atomic number.
unsafe impl Plain for Futex {}
// SAFETY: what it pads is plain.
unsafe impl<T: Plain> Plain for Padded<T> {}
// SAFETY: the cell has the bits of what is inside, which is copied in and out.
unsafe impl<T: Copy + AnyBits + 'static> Plain for Shared<T> {}

/// A value for any bits.
///
/// # Safety
/// As said.
pub(crate) unsafe trait AnyBits {}

// SAFETY: numbers have no invalid bits.
unsafe impl AnyBits for u32 {}
// SAFETY: as above.
unsafe impl AnyBits for u64 {}
// SAFETY: numbers side by side.
unsafe impl<T: AnyBits, const N: usize> AnyBits for [T; N] {}

/// The largest count another process is believed, so that sums of counts fit: a million a second for nine
/// years.
const MOST: u64 = 1 << 48;

/// Limits a count that may lie where another process has written anything.
pub(crate) fn told(count: u64) -> u64 {
    count.min(MOST)
}

/// Lays parts out one behind the other: once to learn the size, once for good.
pub struct Layout {
    region: Option<Arc<Region>>,
    /// The parts get their first values; the other end has done that already.
    fresh: bool,
    at: usize,
}

impl Layout {
    /// Lays `parts` out on the heap.
    pub(crate) fn on_heap<T>(parts: impl Fn(&mut Layout) -> T) -> T {
        let region = Region::heap(Self::measure(&parts));
        parts(&mut Layout { region: Some(region), fresh: true, at: 0 })
    }

    /// Returns the number of bytes `parts` take.
    pub fn measure<T>(parts: impl FnOnce(&mut Layout) -> T) -> usize {
        let mut dry = Layout { region: None, fresh: false, at: 0 };
        drop(parts(&mut dry));
        dry.at
    }

    /// Begins a layout in fresh memory, for the process that made it.
    pub fn fresh(region: &Arc<Region>) -> Layout {
        Layout { region: Some(Arc::clone(region)), fresh: true, at: 0 }
    }

    /// Begins a layout in memory where the other end has laid the same parts out.
    pub fn of_other_end(region: &Arc<Region>) -> Layout {
        Layout { region: Some(Arc::clone(region)), fresh: false, at: 0 }
    }

    /// Returns the first `n` words of a region, to see what another process could do to it.
    #[cfg(not(loom))]
    #[doc(hidden)]
    pub fn words(region: &Arc<Region>, n: usize) -> impl Deref<Target = [AtomicU64]> {
        Layout::of_other_end(region).table(n, |_| AtomicU64::new(0))
    }

    /// The block; `None` while the parts are measured.
    pub(crate) fn region(&self) -> Option<Arc<Region>> {
        self.region.clone()
    }

    pub(crate) fn scope(&self) -> Scope {
        self.region.as_ref().map_or(Scope::Process, |region| region.scope())
    }

    /// Takes room for a part: its block and its offset there. While a layout is measured each part has a
    /// block of its own.
    fn take(&mut self, bytes: usize) -> (Arc<Region>, usize) {
        let at = self.at;
        // Loom's parts are told apart by their beginning.
        let bytes = if cfg!(loom) { bytes.max(1) } else { bytes };
        let end = at.checked_add(bytes).and_then(|end| end.checked_next_multiple_of(ALIGN));
        self.at = end.expect("the parts of a link fit into memory");
        self.region.clone().map_or_else(|| (Region::heap(bytes), 0), |region| (region, at))
    }

    /// `n` values side by side, at first as `first` says.
    #[cfg(not(loom))]
    pub(crate) fn table<T: Plain>(&mut self, n: usize, first: impl Fn(usize) -> T) -> Table<T> {
        const { assert!(align_of::<T>() <= ALIGN, "parts begin at multiples of ALIGN") };
        let bytes = n.checked_mul(size_of::<T>()).expect("a part fits into memory");
        let (region, at) = self.take(bytes);
        // Both ends are looked at, since `at` checks one of them only.
        let _end = region.at(at + bytes);
        let start = region.at(at).cast::<T>();
        if self.fresh {
            for i in 0..n {
                // SAFETY: the part lies inside the block and nobody else uses it yet.
                unsafe { start.add(i).write(first(i)) };
            }
        }
        let start = std::ptr::NonNull::new(start).expect("an address inside a block is not 0");
        Table { start, len: n, _region: region }
    }

    #[cfg(loom)]
    pub(crate) fn table<T: Plain>(&mut self, n: usize, first: impl Fn(usize) -> T) -> Table<T> {
        let (region, at) = self.take(n * size_of::<T>());
        Table(region.part(at, || (0..n).map(first).collect()))
    }

    /// One value.
    #[cfg(not(loom))]
    pub(crate) fn place<T: Plain>(&mut self, first: impl Fn() -> T) -> Place<T> {
        let Table { start, _region, .. } = self.table(1, |_| first());
        Place { start, _region }
    }

    #[cfg(loom)]
    pub(crate) fn place<T: Plain>(&mut self, first: impl Fn() -> T) -> Place<T> {
        Place(self.table(1, |_| first()))
    }

    /// Bytes that begin at a multiple of 64.
    pub(crate) fn bytes(&mut self, len: usize) -> Bytes {
        let (region, at) = self.take(len);
        // Both ends are looked at, since `at` checks one of them only.
        let _end = region.at(at + len);
        Bytes { start: region.at(at), len, _region: region }
    }
}

/// Values side by side in a region.
#[cfg(not(loom))]
pub(crate) struct Table<T> {
    start: std::ptr::NonNull<T>,
    len: usize,
    /// Keeps the block.
    _region: Arc<Region>,
}

#[cfg(loom)]
pub(crate) struct Table<T>(Arc<Box<[T]>>);

#[cfg(not(loom))]
impl<T> Deref for Table<T> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        // SAFETY: `len` values of a type for any bits lie there, in a block this table keeps.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.len) }
    }
}

#[cfg(loom)]
impl<T> Deref for Table<T> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        &self.0
    }
}

// SAFETY: a table is a reference to its values and a counted one to their block.
unsafe impl<T: Sync> Send for Table<T> {}
// SAFETY: as above.
unsafe impl<T: Sync> Sync for Table<T> {}

/// One value in a region.
#[cfg(not(loom))]
pub(crate) struct Place<T> {
    start: std::ptr::NonNull<T>,
    /// Keeps the block.
    _region: Arc<Region>,
}

#[cfg(loom)]
pub(crate) struct Place<T>(Table<T>);

#[cfg(not(loom))]
impl<T> Deref for Place<T> {
    type Target = T;
    #[inline]
    fn deref(&self) -> &T {
        // SAFETY: a value of a type for any bits lies there, in a block this place keeps.
        unsafe { self.start.as_ref() }
    }
}

#[cfg(loom)]
impl<T> Deref for Place<T> {
    type Target = T;
    fn deref(&self) -> &T {
        &self.0[0]
    }
}

// SAFETY: a place is a reference to its value and a counted one to its block.
unsafe impl<T: Sync> Send for Place<T> {}
// SAFETY: as above.
unsafe impl<T: Sync> Sync for Place<T> {}

/// Bytes in a region, reached by address. Its users decide which thread may touch which of them.
pub(crate) struct Bytes {
    start: *mut u8,
    len: usize,
    _region: Arc<Region>,
}

impl Bytes {
    /// The address of byte `offset`.
    #[inline]
    pub(crate) fn at(&self, offset: usize) -> *mut u8 {
        assert!(offset <= self.len, "offset {offset} is outside the {} bytes", self.len);
        // SAFETY: the part lies inside the block, and the offset was just checked to lie inside the part or
        // one past its end.
        unsafe { self.start.add(offset) }
    }
}

// SAFETY: plain bytes without an owner thread, in a block that is kept.
unsafe impl Send for Bytes {}
// SAFETY: as above: `&Bytes` only gives addresses out.
unsafe impl Sync for Bytes {}

//! The memory of a pool and the order of its slots in it: of this process's own pool, or of another one's,
//! for reading.
//!
//! Invariant: lengths are kept here, never read from the memory; every slot lies inside.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use crate::buf::round_up;
use crate::mapping::{Mapping, Writers};
use crate::os::OsError;

/// Layout of the slots of a pool in its memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolShape {
    pub slots: u32,
    pub header_bytes: usize,
    /// The longest frame, after the header.
    pub max_bytes: usize,
}

/// The memory of a pool.
pub struct PoolFile {
    memory: Mapping,
    shape: PoolShape,
    stride: usize,
    /// Number in this process, never used again.
    number: u64,
}

/// Every pool this process can tell others of, by number.
static FILES: Mutex<(u64, BTreeMap<u64, Weak<PoolFile>>)> = Mutex::new((0, BTreeMap::new()));

fn files() -> MutexGuard<'static, (u64, BTreeMap<u64, Weak<PoolFile>>)> {
    FILES.lock().unwrap_or_else(PoisonError::into_inner)
}

impl PoolShape {
    /// Bytes of a slot and of the pool; `None` for no slots or more bytes than an address can reach.
    pub(super) fn size(self) -> Option<(usize, usize)> {
        let header = self.header_bytes.checked_next_multiple_of(64)?;
        let stride = header.checked_add(self.max_bytes.checked_next_multiple_of(64)?)?.max(64);
        let total = stride.checked_mul(self.slots as usize)?;
        (1..=isize::MAX as usize).contains(&total).then_some((stride, total))
    }

    fn sized(self) -> io::Result<(usize, usize)> {
        let PoolShape { slots, header_bytes, max_bytes } = self;
        let why = || format!("a pool of {slots} slots of {header_bytes} + {max_bytes} bytes cannot exist");
        self.size().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, why()))
    }
}

impl PoolFile {
    pub(super) fn create(shape: PoolShape) -> io::Result<Arc<Self>> {
        let (stride, total) = shape.sized()?;
        Ok(Self::enter(Mapping::create("a frame pool", total, Writers::Maker)?, shape, stride))
    }

    /// The pool of another process, for reading.
    ///
    /// # Errors
    /// The memory is not what a pool of this shape has.
    pub fn open(fd: OwnedFd, shape: PoolShape) -> io::Result<Arc<Self>> {
        let (stride, total) = shape.sized()?;
        Ok(Self::enter(Mapping::open(fd, total, Writers::Maker)?, shape, stride))
    }

    fn enter(memory: Mapping, shape: PoolShape, stride: usize) -> Arc<Self> {
        let mut files = files();
        files.0 += 1;
        let number = files.0;
        let file = Arc::new(Self { memory, shape, stride, number });
        files.1.insert(number, Arc::downgrade(&file));
        file
    }

    /// The pool of this number; `None` when it is gone.
    pub fn numbered(number: u64) -> Option<Arc<Self>> {
        files().1.get(&number).and_then(Weak::upgrade)
    }

    /// Returns the number other parts of this process know it by.
    pub fn number(&self) -> u64 {
        self.number
    }

    pub fn shape(&self) -> PoolShape {
        self.shape
    }

    pub fn header_bytes(&self) -> usize {
        self.shape.header_bytes
    }

    /// Returns the descriptor another process needs to read it.
    pub fn fd(&self) -> BorrowedFd<'_> {
        self.memory.fd()
    }

    /// Distance of two slots, in bytes.
    pub fn stride(&self) -> usize {
        self.stride
    }

    pub(super) fn header_ptr(&self, slot: u32) -> *mut u8 {
        self.memory.at(slot as usize * self.stride)
    }

    pub(super) fn bytes_ptr(&self, slot: u32) -> *mut u8 {
        self.memory.at(slot as usize * self.stride + round_up(self.shape.header_bytes, 64))
    }

    pub(super) fn lock(&self) -> Result<(), OsError> {
        crate::os::lock_region(self.memory.at(0), self.memory.len())
    }
}

impl Drop for PoolFile {
    fn drop(&mut self) {
        files().1.remove(&self.number);
    }
}

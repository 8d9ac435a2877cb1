//! The small value types of payloads: `Stamp`, `Flag`, `List`, `Text`, and named integer values.
//!
//! Invariant: reading is safe with any bytes: lengths are clamped, flags are "not zero", names may be
//! unknown.

use crate::payload::Payload;
use core::fmt;
use trocar_plugin_api::desc::{Prim, TypeDesc, TypeKind};

/// A time in ns on the host's monotonic clock; 0 = invalid.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
#[repr(transparent)]
pub struct Stamp(u64);

impl Stamp {
    /// No time: what an invalid stamp is.
    pub const INVALID: Stamp = Stamp(0);

    /// The stamp of this many ns on the host's monotonic clock.
    #[inline]
    pub const fn from_ns(ns: u64) -> Stamp {
        Stamp(ns)
    }

    /// The time in ns on the host's monotonic clock; 0 = invalid.
    #[inline]
    pub const fn ns(self) -> u64 {
        self.0
    }

    /// Tells whether this is a time: 0 is none.
    #[inline]
    pub const fn is_valid(self) -> bool {
        self.0 != 0
    }

    /// Seconds from `earlier` to this stamp; negative when it is the later one. Compare
    /// [`Stamp::seconds_after`].
    #[inline]
    pub fn seconds_since(self, earlier: Stamp) -> f64 {
        self.0.wrapping_sub(earlier.0).cast_signed() as f64 * 1e-9
    }

    /// Returns the seconds by which this stamp is after `earlier`: the time between two samples, for filters.
    /// `None` where the stamps do not tell it: one of them is invalid (the first sample has none before it),
    /// they are equal, or this is the earlier one.
    #[inline]
    pub const fn seconds_after(self, earlier: Stamp) -> Option<f64> {
        if earlier.0 == 0 || self.0 <= earlier.0 { None } else { Some((self.0 - earlier.0) as f64 * 1e-9) }
    }

    /// Tells whether this stamp lies more than `by_s` seconds after `now`. Unlike a difference, right for the
    /// largest stamps, too.
    #[inline]
    pub fn is_ahead_of(self, now: Stamp, by_s: f64) -> bool {
        self.0 > now.0.saturating_add((by_s * 1e9) as u64)
    }
}

// SAFETY: a transparent u64.
unsafe impl Payload for Stamp {
    const DESC: &'static TypeDesc = &TypeDesc::prim(Prim::Stamp);
}

/// A truth value of a payload, one byte; any byte but 0 is true.
#[derive(Clone, Copy, Default)]
#[repr(transparent)]
pub struct Flag(u8);

impl Flag {
    /// The byte 0.
    pub const FALSE: Flag = Flag(0);
    /// The byte 1.
    pub const TRUE: Flag = Flag(1);

    /// The truth value; any byte but 0 is true.
    #[inline]
    pub const fn get(self) -> bool {
        self.0 != 0
    }
}

impl From<bool> for Flag {
    #[inline]
    fn from(value: bool) -> Flag {
        Flag(u8::from(value))
    }
}

impl From<Flag> for bool {
    #[inline]
    fn from(value: Flag) -> bool {
        value.get()
    }
}

impl PartialEq for Flag {
    fn eq(&self, other: &Flag) -> bool {
        self.get() == other.get()
    }
}

impl fmt::Debug for Flag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.get().fmt(f)
    }
}

// SAFETY: a transparent u8; `get` accepts every value.
unsafe impl Payload for Flag {
    const DESC: &'static TypeDesc = &TypeDesc::prim(Prim::Bool);
}

/// Up to `N` items in place. `N · size_of::<T>()` must be a multiple of 8 bytes (checked at compile time).
#[derive(Clone, Copy)]
#[repr(C)]
pub struct List<T, const N: usize> {
    len: u64,
    items: [T; N],
}

impl<T: Payload, const N: usize> List<T, N> {
    /// The first `N` of `items`; the rest does not fit and is left out.
    pub fn of(items: &[T]) -> Self {
        let mut list = Self::default();
        for item in items.iter().take(N) {
            list.push(*item);
        }
        list
    }

    /// Appends; gives the item back when the list is full.
    ///
    /// # Errors
    /// The item, when `N` items are already there.
    pub fn try_push(&mut self, item: T) -> Result<(), T> {
        let at = self.len();
        let Some(place) = self.items.get_mut(at) else { return Err(item) };
        *place = item;
        self.len = at as u64 + 1;
        Ok(())
    }

    /// Appends when there is room; tells whether there was.
    pub fn push(&mut self, item: T) -> bool {
        self.try_push(item).is_ok()
    }

    /// Empties the list and zeroes its tail.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

impl<T, const N: usize> List<T, N> {
    /// Number of items; never above `N`, whatever the bytes say.
    #[inline]
    #[allow(clippy::len_without_is_empty)] // `is_empty` comes from the slice behind Deref.
    pub fn len(&self) -> usize {
        (self.len as usize).min(N)
    }
}

impl<T, const N: usize> core::ops::Deref for List<T, N> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        &self.items[..self.len()]
    }
}

impl<T, const N: usize> core::ops::DerefMut for List<T, N> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        let len = self.len();
        &mut self.items[..len]
    }
}

impl<T: Payload, const N: usize> Default for List<T, N> {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl<T: PartialEq, const N: usize> PartialEq for List<T, N> {
    fn eq(&self, other: &Self) -> bool {
        self[..] == other[..]
    }
}

impl<T: fmt::Debug, const N: usize> fmt::Debug for List<T, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self[..].fmt(f)
    }
}

// SAFETY: a u64 and an array; alignment is at most 8 and the assertion excludes padding at the end. The
// length is clamped on every access, so any bit pattern is fine.
unsafe impl<T: Payload, const N: usize> Payload for List<T, N> {
    const DESC: &'static TypeDesc = {
        assert!(
            (N * size_of::<T>()).is_multiple_of(8),
            "List<T, N>: N times the size of T must be a multiple of 8 bytes, choose a larger N"
        );
        &TypeDesc { size: size_of::<Self>(), align: 8, kind: TypeKind::List { item: T::DESC, n: N } }
    };
}

/// Up to `N` bytes of UTF-8 in place; `N` must be a multiple of 8 (checked at compile time).
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Text<const N: usize> {
    len: u64,
    bytes: [u8; N],
}

impl<const N: usize> Text<N> {
    /// Keeps as much of `text` as fits, cut between characters.
    pub fn new(text: &str) -> Self {
        let mut end = text.len().min(N);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let mut out = Self::zeroed();
        out.bytes[..end].copy_from_slice(&text.as_bytes()[..end]);
        out.len = end as u64;
        out
    }

    /// The text; bytes that are no UTF-8 end it.
    pub fn as_str(&self) -> &str {
        let bytes = &self.bytes[..(self.len as usize).min(N)];
        match core::str::from_utf8(bytes) {
            Ok(text) => text,
            Err(e) => core::str::from_utf8(&bytes[..e.valid_up_to()]).unwrap_or(""),
        }
    }
}

impl<const N: usize> Default for Text<N> {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl<const N: usize> From<&str> for Text<N> {
    fn from(text: &str) -> Self {
        Self::new(text)
    }
}

impl<const N: usize> core::ops::Deref for Text<N> {
    type Target = str;
    fn deref(&self) -> &str {
        self.as_str()
    }
}

impl<const N: usize> PartialEq for Text<N> {
    fn eq(&self, other: &Self) -> bool {
        self.as_str() == other.as_str()
    }
}

impl<const N: usize> PartialEq<&str> for Text<N> {
    fn eq(&self, other: &&str) -> bool {
        self.as_str() == *other
    }
}

impl<const N: usize> fmt::Display for Text<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl<const N: usize> fmt::Debug for Text<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_str().fmt(f)
    }
}

// SAFETY: a u64 and bytes, no padding by the assertion; length and UTF-8 are checked on every access.
unsafe impl<const N: usize> Payload for Text<N> {
    const DESC: &'static TypeDesc = {
        assert!(N.is_multiple_of(8), "Text<N>: N must be a multiple of 8 bytes, choose the next one");
        &TypeDesc { size: size_of::<Self>(), align: 8, kind: TypeKind::Text { n: N } }
    };
}

/// An integer newtype with named values: the payload's form of an enum. Unknown values stay as they are.
///
/// ```
/// use trocar_sdk::prelude::*;
/// named_values! {
///     /// What the arm does.
///     pub struct ArmMode: u32 { IDLE = 0, MOVING = 1 }
/// }
/// assert_eq!(ArmMode::MOVING.name(), Some("MOVING"));
/// assert_eq!(ArmMode(7).name(), None);
/// ```
#[macro_export]
macro_rules! named_values {
    ($(#[$meta:meta])* $vis:vis struct $name:ident : $repr:ident { $($(#[$vmeta:meta])* $value:ident = $number:literal),+ $(,)? }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, PartialEq, Eq, Default, Hash)]
        #[repr(transparent)]
        $vis struct $name(pub $repr);

        #[allow(dead_code)]
        impl $name {
            $($(#[$vmeta])* $vis const $value: $name = $name($number);)+

            /// The name of a known value.
            $vis const fn name(self) -> Option<&'static str> {
                match self.0 {
                    $($number => Some(stringify!($value)),)+
                    #[allow(unreachable_patterns)]
                    _ => None,
                }
            }
        }

        impl ::core::fmt::Debug for $name {
            fn fmt(&self, f: &mut ::core::fmt::Formatter<'_>) -> ::core::fmt::Result {
                match self.name() {
                    Some(name) => f.write_str(name),
                    None => ::core::write!(f, "{}({})", stringify!($name), self.0),
                }
            }
        }

        // SAFETY: a transparent integer; values without a name are valid.
        unsafe impl $crate::Payload for $name {
            const DESC: &'static $crate::__private::TypeDesc = &$crate::__private::TypeDesc {
                size: ::core::mem::size_of::<$repr>(),
                align: ::core::mem::align_of::<$repr>(),
                kind: $crate::__private::TypeKind::Enum {
                    name: stringify!($name),
                    repr: $crate::__private::prim_of::<$repr>(),
                    values: &[$((stringify!($value), $number as i64)),+],
                },
            };
        }
    };
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::payload::{as_bytes, from_bytes};

    #[test]
    fn what_lies_ahead_is_told_of_the_largest_stamps_too() {
        let now = Stamp::from_ns(5_000_000_000);
        assert!(!Stamp::from_ns(5_500_000_000).is_ahead_of(now, 0.5));
        assert!(Stamp::from_ns(5_500_000_001).is_ahead_of(now, 0.5));
        assert!(Stamp::from_ns(u64::MAX).is_ahead_of(now, 0.5) && !Stamp::INVALID.is_ahead_of(now, 0.5));
        assert!(!Stamp::from_ns(u64::MAX).is_ahead_of(Stamp::from_ns(u64::MAX - 1), 0.5));
    }

    #[test]
    fn a_list_with_a_lying_length_is_clamped() {
        let mut bytes = as_bytes(&List::<f64, 2>::of(&[1.0, 2.0])).to_vec();
        bytes[..8].copy_from_slice(&u64::MAX.to_le_bytes());
        let list: List<f64, 2> = from_bytes(&bytes).unwrap();
        assert_eq!(&list[..], &[1.0, 2.0]);
    }

    #[test]
    fn a_full_list_gives_the_item_back() {
        let mut list = List::<f64, 1>::of(&[1.0]);
        assert_eq!(list.try_push(2.0), Err(2.0));
        list.clear();
        assert!(list.is_empty());
    }

    #[test]
    fn text_is_cut_between_characters_and_survives_bytes_that_are_no_utf8() {
        assert_eq!(Text::<8>::new("1234567µ"), "1234567");
        let mut bytes = as_bytes(&Text::<8>::new("ab")).to_vec();
        bytes[9] = 0xff;
        assert_eq!(from_bytes::<Text<8>>(&bytes).unwrap(), "a");
    }

    #[test]
    fn bytes_of_the_wrong_length_are_no_payload() {
        assert_eq!(from_bytes::<f64>(&[0; 7]), None);
    }

    #[test]
    fn stamps_differ_in_signed_seconds() {
        let (a, b) = (Stamp::from_ns(1_000_000_000), Stamp::from_ns(1_500_000_000));
        assert_eq!((b.seconds_since(a), a.seconds_since(b)), (0.5, -0.5));
    }

    #[test]
    fn the_time_between_samples_is_known_only_of_two_valid_stamps_in_order() {
        let (a, b) = (Stamp::from_ns(1_000_000_000), Stamp::from_ns(1_500_000_000));
        assert_eq!(b.seconds_after(a), Some(0.5));
        for (later, earlier) in [(a, b), (a, a), (a, Stamp::INVALID), (Stamp::INVALID, a)] {
            assert_eq!(later.seconds_after(earlier), None, "{later:?} after {earlier:?}");
        }
        let all = Stamp::from_ns(u64::MAX).seconds_after(Stamp::from_ns(1));
        assert!(all.is_some_and(|s| s > 1.8e10), "{all:?}");
    }
}

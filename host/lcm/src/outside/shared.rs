//! One object for each followed output or event, shared by all its readers.
//!
//! Invariant: it lives as long as it has readers, and no reader joins one that has ended.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

use parking_lot::Mutex;

pub(super) struct Shared<K, T>(Mutex<BTreeMap<K, Weak<T>>>);

impl<K, T> Default for Shared<K, T> {
    fn default() -> Self {
        Shared(Mutex::default())
    }
}

impl<K: Ord, T> Shared<K, T> {
    /// Returns the object of this key if it still holds, or a new one.
    pub(super) fn join<E>(
        &self,
        key: K,
        holds: impl FnOnce(&T) -> bool,
        make: impl FnOnce() -> Result<Arc<T>, E>,
    ) -> Result<Arc<T>, E> {
        let mut all = self.0.lock();
        if let Some(there) = all.get(&key).and_then(Weak::upgrade).filter(|there| holds(there)) {
            return Ok(there);
        }
        all.retain(|_, one| one.strong_count() > 0);
        let made = make()?;
        all.insert(key, Arc::downgrade(&made));
        Ok(made)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn who_comes_while_it_holds_shares_it_and_another_one_is_made_after_that() {
        let shared = Shared::<u8, u8>::default();
        let join = |holds, made| shared.join::<()>(1, |_| holds, || Ok(Arc::new(made))).unwrap();
        let first = join(true, 10);
        assert_eq!(*join(true, 11), 10);
        assert_eq!(*join(false, 12), 12, "it has come to its end, although somebody still looks at it");
        drop(first);
        assert_eq!(*join(true, 13), 13, "nobody looked at it any more");
        assert_eq!(shared.join(2, |_| true, || Err("refused")), Err("refused"));
        assert!(shared.0.lock().len() <= 1, "what was looked at leaves nothing");
    }
}

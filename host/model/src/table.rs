//! A sorted map whose copies share their rows, and which knows what of it has changed.
//!
//! Invariant: after [`Table::settle`] each row has the number of the state in which it was last different,
//! and what settle tells is what a comparison of both states would tell. To copy a table costs the same
//! however large it is; a change copies the rows around it, and a value while another copy has it.

use std::borrow::Borrow;
use std::collections::BTreeMap;
use std::fmt;
use std::ops::{Index, RangeBounds};
use std::sync::Arc;

use imbl::OrdMap;
use imbl::ordmap;
use imbl::shared_ptr::DefaultSharedPtr;

#[derive(Clone)]
pub struct Table<K, V> {
    rows: OrdMap<K, Row<V>>,
    /// Values before the first change since the last settle; `None`: there was no such row.
    before: BTreeMap<K, Option<Row<V>>>,
}

struct Row<V> {
    /// Number of the state in which it was last different.
    at: u64,
    value: Arc<V>,
}

impl<V> Clone for Row<V> {
    fn clone(&self) -> Self {
        Row { at: self.at, value: self.value.clone() }
    }
}

impl<K, V> Table<K, V> {
    pub fn new() -> Table<K, V> {
        Table { rows: OrdMap::new(), before: BTreeMap::new() }
    }

    pub fn len(&self) -> usize {
        self.rows.len()
    }

    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }
}

impl<K: Ord, V> Table<K, V> {
    /// In the order of the keys.
    pub fn iter(&self) -> Iter<'_, K, V> {
        Iter(self.rows.iter())
    }

    /// Sorted.
    pub fn keys(&self) -> impl DoubleEndedIterator<Item = &K> + ExactSizeIterator + Clone {
        self.iter().map(|(key, _)| key)
    }

    /// In the order of the keys.
    pub fn values(&self) -> impl DoubleEndedIterator<Item = &V> + ExactSizeIterator + Clone {
        self.iter().map(|(_, value)| value)
    }

    /// Number of the state in which a row was last different, the greatest of all; 0: there is none.
    pub fn newest(&self) -> u64 {
        self.rows.values().map(|row| row.at).max().unwrap_or_default()
    }
}

impl<K: Ord + Clone, V: Clone> Table<K, V> {
    pub fn get<Q: Ord + ?Sized>(&self, key: &Q) -> Option<&V>
    where
        K: Borrow<Q>,
    {
        self.rows.get(key).map(|row| &*row.value)
    }

    pub fn get_key_value<Q: Ord + ?Sized>(&self, key: &Q) -> Option<(&K, &V)>
    where
        K: Borrow<Q>,
    {
        self.rows.get_key_value(key).map(|(key, row)| (key, &*row.value))
    }

    pub fn contains_key<Q: Ord + ?Sized>(&self, key: &Q) -> bool
    where
        K: Borrow<Q>,
    {
        self.rows.contains_key(key)
    }

    /// The rows within a range of keys, sorted.
    pub fn range<Q: Ord + ?Sized>(
        &self,
        range: impl RangeBounds<Q>,
    ) -> impl DoubleEndedIterator<Item = (&K, &V)>
    where
        K: Borrow<Q>,
    {
        self.rows.range(range).map(|(key, row)| (key, &*row.value))
    }

    /// A value to be changed. It counts as changed only if it is different at the next settle.
    pub fn get_mut(&mut self, key: &K) -> Option<&mut V> {
        let row = self.rows.get_mut(key)?;
        if !self.before.contains_key(key) {
            self.before.insert(key.clone(), Some(row.clone()));
        }
        Some(Arc::make_mut(&mut row.value))
    }

    /// Puts a value in, in the place of one that is there.
    pub fn insert(&mut self, key: K, value: V) {
        let was = self.rows.insert(key.clone(), Row { at: 0, value: Arc::new(value) });
        self.before.entry(key).or_insert(was);
    }

    /// Takes a value out.
    pub fn remove(&mut self, key: &K) -> Option<Arc<V>> {
        let (key, row) = self.rows.remove_with_key(key)?;
        self.before.entry(key).or_insert_with(|| Some(row.clone()));
        Some(row.value)
    }

    /// Keeps the rows for which `keep` is true.
    pub fn retain(&mut self, mut keep: impl FnMut(&K, &V) -> bool) {
        let goes = self.iter().filter(|(key, value)| !keep(key, value));
        let gone: Vec<K> = goes.map(|(key, _)| key.clone()).collect();
        for key in gone {
            self.remove(&key);
        }
    }

    /// Changes the rows for which `concerns` is true.
    pub fn change(&mut self, concerns: impl Fn(&K, &V) -> bool, mut change: impl FnMut(&mut V)) {
        let concerned = self.iter().filter(|(key, value)| concerns(key, value));
        let keys: Vec<K> = concerned.map(|(key, _)| key.clone()).collect();
        for key in keys {
            self.get_mut(&key).into_iter().for_each(&mut change);
        }
    }

    pub fn clear(&mut self) {
        self.retain(|_, _| false);
    }

    /// Counts a row as different though its value is not: what is shown of it depends on others. False: there
    /// is none.
    pub(crate) fn touch(&mut self, key: &K, at: u64) -> bool {
        let row = self.rows.get_mut(key);
        row.map(|row| row.at = at).is_some()
    }

    /// Returns the rows that are different since the last settle, new or gone, as they were then, and gives
    /// those that are there the number of this state.
    pub(crate) fn settle(&mut self, at: u64) -> Vec<(K, Option<Arc<V>>)>
    where
        V: PartialEq,
    {
        let mut changed = Vec::new();
        for (key, before) in std::mem::take(&mut self.before) {
            let now = self.rows.get_mut(&key);
            match (&before, now) {
                (None, None) => continue,
                (Some(was), Some(now)) if was.is_same(now) => {
                    now.at = was.at;
                    continue;
                }
                (_, Some(now)) => now.at = at,
                (Some(_), None) => {}
            }
            changed.push((key, before.map(|was| was.value)));
        }
        changed
    }
}

impl<V: PartialEq> Row<V> {
    fn is_same(&self, other: &Row<V>) -> bool {
        Arc::ptr_eq(&self.value, &other.value) || self.value == other.value
    }
}

/// The rows of a table, in the order of the keys.
pub struct Iter<'a, K, V>(ordmap::Iter<'a, K, Row<V>, DefaultSharedPtr>);

impl<K, V> Clone for Iter<'_, K, V> {
    fn clone(&self) -> Self {
        Iter(self.0.clone())
    }
}

impl<'a, K: Ord, V> Iterator for Iter<'a, K, V> {
    type Item = (&'a K, &'a V);

    fn next(&mut self) -> Option<Self::Item> {
        self.0.next().map(|(key, row)| (key, &*row.value))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.0.size_hint()
    }
}

impl<K: Ord, V> DoubleEndedIterator for Iter<'_, K, V> {
    fn next_back(&mut self) -> Option<Self::Item> {
        self.0.next_back().map(|(key, row)| (key, &*row.value))
    }
}

impl<K: Ord, V> ExactSizeIterator for Iter<'_, K, V> {}

impl<'a, K: Ord, V> IntoIterator for &'a Table<K, V> {
    type Item = (&'a K, &'a V);
    type IntoIter = Iter<'a, K, V>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<K: Ord + Clone, V: Clone> Extend<(K, V)> for Table<K, V> {
    fn extend<T: IntoIterator<Item = (K, V)>>(&mut self, rows: T) {
        for (key, value) in rows {
            self.insert(key, value);
        }
    }
}

impl<K: Ord + Clone, V: Clone> FromIterator<(K, V)> for Table<K, V> {
    fn from_iter<T: IntoIterator<Item = (K, V)>>(rows: T) -> Self {
        let mut table = Table::new();
        table.extend(rows);
        table
    }
}

impl<K, V> Default for Table<K, V> {
    fn default() -> Self {
        Table::new()
    }
}

/// Compares the values; not what has changed.
impl<K: Ord, V: PartialEq> PartialEq for Table<K, V> {
    fn eq(&self, other: &Self) -> bool {
        self.rows.len() == other.rows.len()
            && self.rows.iter().zip(&other.rows).all(|((k, a), (l, b))| k == l && a.is_same(b))
    }
}

impl<K: Ord + Clone, V: Clone> Index<&K> for Table<K, V> {
    type Output = V;

    fn index(&self, key: &K) -> &V {
        &self.rows[key].value
    }
}

impl<K: Ord + fmt::Debug, V: fmt::Debug> fmt::Debug for Table<K, V> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_map().entries(self).finish()
    }
}

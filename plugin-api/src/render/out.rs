//! JSON, written byte by byte in a const context.
//!
//! Invariant: the same count of bytes whether they are kept (`N > 0`) or only counted; text is escaped as
//! JSON asks.

/// Text written so far; with `N = 0` only its length.
pub(super) struct Out<const N: usize> {
    pub(super) buf: [u8; N],
    pub(super) len: usize,
}

impl<const N: usize> Out<N> {
    pub(super) const fn byte(&mut self, b: u8) {
        if N > 0 {
            self.buf[self.len] = b;
        }
        self.len += 1;
    }

    pub(super) const fn raw(&mut self, text: &str) {
        let bytes = text.as_bytes();
        let mut i = 0;
        while i < bytes.len() {
            self.byte(bytes[i]);
            i += 1;
        }
    }

    pub(super) const fn text(&mut self, text: &str) {
        let bytes = text.as_bytes();
        self.byte(b'"');
        let mut i = 0;
        while i < bytes.len() {
            match bytes[i] {
                b'"' | b'\\' => {
                    self.byte(b'\\');
                    self.byte(bytes[i]);
                }
                b'\n' => self.raw("\\n"),
                b'\t' => self.raw("\\t"),
                c if c < 0x20 => {
                    self.raw("\\u00");
                    self.byte(b"0123456789abcdef"[(c >> 4) as usize]);
                    self.byte(b"0123456789abcdef"[(c & 15) as usize]);
                }
                c => self.byte(c),
            }
            i += 1;
        }
        self.byte(b'"');
    }

    pub(super) const fn number(&mut self, n: u64) {
        if n >= 10 {
            self.number(n / 10);
        }
        self.byte(b'0' + (n % 10) as u8);
    }

    pub(super) const fn signed(&mut self, n: i64) {
        if n < 0 {
            self.byte(b'-');
        }
        self.number(n.unsigned_abs());
    }

    /// `"key":` preceded by a comma unless it is the first of its object.
    pub(super) const fn key(&mut self, key: &str, first: bool) {
        if !first {
            self.byte(b',');
        }
        self.text(key);
        self.byte(b':');
    }

    pub(super) const fn pair(&mut self, key: &str, value: &str, first: bool) {
        self.key(key, first);
        self.text(value);
    }

    /// Like `pair`, but leaves the key out when the value is empty.
    pub(super) const fn pair_opt(&mut self, key: &str, value: &str) {
        if !value.is_empty() {
            self.pair(key, value, false);
        }
    }

    pub(super) const fn flag(&mut self, key: &str, value: bool) {
        if value {
            self.key(key, false);
            self.raw("true");
        }
    }

    pub(super) const fn literal_opt(&mut self, key: &str, json: &str) {
        if !json.is_empty() {
            self.key(key, false);
            self.raw(json);
        }
    }

    pub(super) const fn comma(&mut self, i: usize) {
        if i > 0 {
            self.byte(b',');
        }
    }
}

//! Texts while a plugin is compiled: compared, and put together to the message that ends the build.

/// A message put together while compiling; text that does not fit is left out.
pub(crate) struct Sentence {
    bytes: [u8; 400],
    len: usize,
}

impl Sentence {
    pub(crate) const fn of(text: &str) -> Sentence {
        Sentence { bytes: [0; 400], len: 0 }.text(text)
    }

    pub(crate) const fn text(mut self, text: &str) -> Sentence {
        let text = text.as_bytes();
        // Whole or not at all: it stays UTF-8.
        if self.len + text.len() > self.bytes.len() {
            return self;
        }
        let mut i = 0;
        while i < text.len() {
            self.bytes[self.len] = text[i];
            self.len += 1;
            i += 1;
        }
        self
    }

    pub(crate) const fn number(self, n: usize) -> Sentence {
        const DIGITS: [&str; 10] = ["0", "1", "2", "3", "4", "5", "6", "7", "8", "9"];
        let rest = if n >= 10 { self.number(n / 10) } else { self };
        rest.text(DIGITS[n % 10])
    }

    pub(crate) const fn fail(&self) -> ! {
        match core::str::from_utf8(self.bytes.split_at(self.len).0) {
            Ok(text) => panic!("{}", text),
            Err(_) => panic!("whole texts were put together"),
        }
    }
}

/// Tells whether two texts are the same.
pub(crate) const fn same_text(a: &str, b: &str) -> bool {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    if a.len() != b.len() {
        return false;
    }
    let mut i = 0;
    while i < a.len() {
        if a[i] != b[i] {
            return false;
        }
        i += 1;
    }
    true
}

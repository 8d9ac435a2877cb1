//! The descriptions of outputs, one text each: `force: fx N, fy N, fz N`, `tip: Pose`, `count: u64`.
//!
//! Invariant: what is taken here has a type that a host takes; a description that is refused is quoted, with
//! what to write instead.

use std::mem::offset_of;

use trocar_sdk::data::{JointState, MAX_JOINTS, Message, Pose, Scalar, Twist, Wrench};
use trocar_sdk::prelude::*;
use trocar_sdk::{AnyType, as_bytes};

/// Bytes of a text that does not say how many.
const TEXT: usize = 64;
/// Most items of an array.
const ITEMS: usize = 1024;
/// Most fields of an output.
const FIELDS: usize = 256;

/// One output as described.
pub(crate) struct Described {
    pub(crate) name: String,
    pub(crate) ty: AnyType,
    /// A value of the type, of which every line fills in its parts.
    pub(crate) blank: Vec<u8>,
    /// The places of its stamps.
    pub(crate) stamps: Vec<usize>,
    pub(crate) parts: Vec<Part>,
    /// Behind `=` of a payload with several parts: its first column, or the path of its object.
    pub(crate) from: Option<String>,
}

/// Numbers of an output that come from one field of a line, or from columns side by side.
pub(crate) struct Part {
    /// Its name; empty where the output has no fields.
    pub(crate) name: String,
    /// Place of the first item.
    pub(crate) at: usize,
    pub(crate) kind: Kind,
    /// Items of an array; `None`: a single value.
    pub(crate) n: Option<usize>,
    /// Behind `=`: a column, or a path of JSON.
    pub(crate) from: Option<String>,
}

/// A value that a line has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    F64,
    F32,
    I64,
    I32,
    U64,
    U32,
    Bool,
    /// Room in bytes.
    Text(usize),
}

impl Kind {
    fn named(word: &str) -> Option<Kind> {
        Some(match word {
            "f64" => Kind::F64,
            "f32" => Kind::F32,
            "i64" => Kind::I64,
            "i32" => Kind::I32,
            "u64" => Kind::U64,
            "u32" => Kind::U32,
            "bool" => Kind::Bool,
            "text" => Kind::Text(TEXT),
            _ => return None,
        })
    }

    pub(crate) fn size(self) -> usize {
        match self {
            Kind::F64 | Kind::I64 | Kind::U64 => 8,
            Kind::F32 | Kind::I32 | Kind::U32 => 4,
            Kind::Bool => 1,
            Kind::Text(n) => 8 + n,
        }
    }

    /// In memory; a text begins with its length.
    fn align(self) -> usize {
        if let Kind::Text(_) = self { 8 } else { self.size() }
    }

    fn ty(self) -> Result<AnyType> {
        Ok(match self {
            Kind::F64 => AnyType::of::<f64>(),
            Kind::F32 => AnyType::of::<f32>(),
            Kind::I64 => AnyType::of::<i64>(),
            Kind::I32 => AnyType::of::<i32>(),
            Kind::U64 => AnyType::of::<u64>(),
            Kind::U32 => AnyType::of::<u32>(),
            Kind::Bool => AnyType::of::<Flag>(),
            Kind::Text(n) => AnyType::text(n)?,
        })
    }
}

/// One field as written.
struct Field<'a> {
    name: &'a str,
    n: Option<usize>,
    kind: Option<Kind>,
    unit: &'a str,
    from: Option<String>,
}

impl Described {
    /// # Errors
    /// The text is no description.
    pub(crate) fn read(text: &str) -> Result<Described> {
        let wrong = |why: String| format!("outputs: {text:?}: {why}");
        let form = "write NAME: FIELD UNIT, …, such as \"force: fx N, fy N\"";
        let (name, rest) = text.split_once(':').ok_or_else(|| wrong(format!("no `:` in it; {form}")))?;
        let name = name.trim();
        let fields = rest.split(',').map(|part| Field::read(part.trim()));
        let fields = fields.collect::<Result<Vec<_>, _>>().map_err(|why| wrong(format!("{why}; {form}")))?;
        let made = match fields.as_slice() {
            [only] if only.is_bare() => match Described::whole(name, only) {
                Some(whole) => whole,
                None => Described::made(name, &fields),
            },
            fields => Described::made(name, fields),
        };
        made.map_err(|why| wrong(why.to_string()).into())
    }

    /// An output of a payload or a plain number, if the only field is the name of one.
    fn whole(name: &str, field: &Field<'_>) -> Option<Result<Described>> {
        if let Some(kind) = Kind::named(field.name) {
            return Some(Described::plain(name, kind, field));
        }
        macro_rules! payload {
            ($ty:ty, $($part:ident $kind:expr, $n:expr);+) => {
                Described::payload::<$ty>(name, field, &<$ty>::default(), offset_of!($ty, stamp),
                        &[$((stringify!($part), offset_of!($ty, $part), $kind, $n)),+])
            };
        }
        let made = match field.name {
            "Scalar" => payload!(Scalar, value Kind::F64, None),
            "Message" => payload!(Message, text Kind::Text(240), None),
            "Pose" => payload!(Pose, position Kind::F64, Some(3); orientation Kind::F64, Some(4)),
            "Twist" => payload!(Twist, linear Kind::F64, Some(3); angular Kind::F64, Some(3)),
            "Wrench" => payload!(Wrench, force Kind::F64, Some(3); torque Kind::F64, Some(3)),
            "JointState" => return Some(Described::joints(name, field)),
            _ => return None,
        };
        Some(match field.n {
            Some(_) => Err(format!("{} is not an array: leave the brackets out", field.name).into()),
            None => Ok(made),
        })
    }

    /// Positions of a number of joints.
    fn joints(name: &str, field: &Field<'_>) -> Result<Described> {
        let Some(n @ 1..=MAX_JOINTS) = field.n else {
            let why = format!("how many joints? write JointState[6], 1 to {MAX_JOINTS} of them");
            return Err(why.into());
        };
        let blank = JointState { position: List::of(&[0.0; MAX_JOINTS][..n]), ..JointState::default() };
        // Behind the length of the list.
        let at = offset_of!(JointState, position) + 8;
        let parts = [("position", at, Kind::F64, Some(n))];
        Ok(Described::payload(name, field, &blank, offset_of!(JointState, stamp), &parts))
    }

    /// An output of a payload: its stamp and the parts that a line fills in, with their places, kinds and
    /// numbers of items. A single part takes what stands behind `=` for itself.
    fn payload<T: Payload>(
        name: &str,
        field: &Field<'_>,
        blank: &T,
        stamp: usize,
        parts: &[(&str, usize, Kind, Option<usize>)],
    ) -> Described {
        let from = &field.from;
        let single = parts.len() == 1;
        let part = |&(part, at, kind, n): &(&str, usize, Kind, Option<usize>)| Part {
            name: part.to_owned(),
            at,
            kind,
            n,
            from: if single { from.clone() } else { None },
        };
        Described {
            name: name.to_owned(),
            ty: AnyType::of::<T>(),
            blank: as_bytes(blank).to_vec(),
            stamps: vec![stamp],
            parts: parts.iter().map(part).collect(),
            from: if single { None } else { from.clone() },
        }
    }

    fn plain(name: &str, kind: Kind, field: &Field<'_>) -> Result<Described> {
        let (kind, n) = sized(kind, field.n)?;
        let ty = match n {
            Some(n) => AnyType::array(kind.ty()?, n)?,
            None => kind.ty()?,
        };
        let part = Part { name: String::new(), at: 0, kind, n, from: field.from.clone() };
        let blank = vec![0; ty.size()];
        Ok(Described { name: name.to_owned(), ty, blank, stamps: Vec::new(), parts: vec![part], from: None })
    }

    /// An output with a type of its own: a stamp, then the fields, larger ones first.
    fn made(name: &str, fields: &[Field<'_>]) -> Result<Described> {
        if fields.len() > FIELDS {
            return Err(format!("{} fields are too many, there is room for {FIELDS}", fields.len()).into());
        }
        let mut parts = Vec::new();
        for field in fields {
            if field.name == "stamp" {
                return Err("`stamp` is there already: every sample has it; name the field otherwise".into());
            }
            let (kind, n) = sized(field.kind.unwrap_or(Kind::F64), field.n)?;
            let (name, from) = (field.name.to_owned(), field.from.clone());
            parts.push((field.unit, Part { name, at: 0, kind, n, from }));
        }
        let mut order: Vec<usize> = (0..parts.len()).collect();
        order.sort_by_key(|at| std::cmp::Reverse(parts[*at].1.kind.align()));
        let mut types = vec![("stamp".to_owned(), AnyType::of::<Stamp>(), "")];
        let mut size = 8;
        for at in order {
            let (unit, part) = &mut parts[at];
            part.at = size;
            let ty = match part.n {
                Some(n) => AnyType::array(part.kind.ty()?, n)?,
                None => part.kind.ty()?,
            };
            size += ty.size();
            types.push((part.name.clone(), ty, *unit));
        }
        let gap = size.next_multiple_of(8) - size;
        if gap > 0 {
            types.push(("reserved".to_owned(), AnyType::array(AnyType::of::<u8>(), gap)?, ""));
        }
        let given = types.iter().map(|(name, ty, unit)| (name.as_str(), ty.clone(), *unit));
        let ty = AnyType::structure(&type_name(name), given)?;
        let blank = vec![0; ty.size()];
        let parts = parts.into_iter().map(|(_, part)| part).collect();
        Ok(Described { name: name.to_owned(), ty, blank, stamps: vec![0], parts, from: None })
    }
}

impl<'a> Field<'a> {
    fn read(text: &'a str) -> Result<Field<'a>, String> {
        let (left, from) = match text.split_once('=') {
            Some((left, from)) if !from.trim().is_empty() => (left, Some(from.trim().to_owned())),
            Some(_) => {
                return Err(format!("nothing behind `=` in {text:?}: name a column or a field of JSON"));
            }
            None => (text, None),
        };
        let mut words = left.split_whitespace();
        let head = words.next().ok_or("a field without a name")?;
        let (name, n) = match head.split_once('[') {
            None => (head, None),
            Some((name, n)) => {
                let n = n.strip_suffix(']').and_then(|n| n.parse().ok()).filter(|n| (1..=ITEMS).contains(n));
                (name, Some(n.ok_or_else(|| format!("{head:?}: give 1 to {ITEMS} items, such as f[3]"))?))
            }
        };
        let begins = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
        if !begins || !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
            return Err(format!("{name:?} is not a name: letters, digits and _, a letter first"));
        }
        let mut field = Field { name, n, kind: None, unit: "", from };
        for word in words {
            match Kind::named(word) {
                Some(kind) if field.kind.is_none() => field.kind = Some(kind),
                None if field.unit.is_empty() => field.unit = word,
                _ => return Err(format!("one word too many in {left:?}: a field has a type and a unit")),
            }
        }
        Ok(field)
    }

    fn is_bare(&self) -> bool {
        self.kind.is_none() && self.unit.is_empty()
    }
}

/// A text has bytes where others have items.
fn sized(kind: Kind, n: Option<usize>) -> Result<(Kind, Option<usize>)> {
    match (kind, n) {
        (Kind::Text(_), Some(n)) => Ok((Kind::Text(n.next_multiple_of(8)), None)),
        (kind, n) => Ok((kind, n)),
    }
}

/// `tool_force` → `ToolForce`.
fn type_name(output: &str) -> String {
    let words = output.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    let upper = |word: &str| word[..1].to_ascii_uppercase() + &word[1..];
    words.map(upper).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Described {
        Described::read(text).unwrap_or_else(|why| panic!("{why}"))
    }

    #[test]
    fn fields_get_their_types_units_and_places_larger_ones_first() {
        let force = of("tool_force: fx N, ok bool, f[3] f32 mN, word[10] text = label");
        let port = force.ty.to_port();
        assert_eq!(port["plain"]["ref"], "ToolForce");
        let names: Vec<&str> = port["types"][0]["fields"]
            .as_array()
            .unwrap()
            .iter()
            .map(|f| f["name"].as_str().unwrap())
            .collect();
        assert_eq!(names, ["stamp", "fx", "word", "f", "ok", "reserved"]);
        assert_eq!((force.ty.size(), force.ty.unit("fx"), force.ty.unit("f/0")), (56, "N", "mN"));
        let parts: Vec<(&str, usize)> = force.parts.iter().map(|p| (p.name.as_str(), p.at)).collect();
        assert_eq!(parts, [("fx", 8), ("ok", 52), ("f", 40), ("word", 16)]);
        assert_eq!(force.parts[3].from.as_deref(), Some("label"));
        assert_eq!((force.parts[2].n, force.parts[3].kind), (Some(3), Kind::Text(16)));
    }

    #[test]
    fn payloads_and_plain_numbers_are_those_that_others_take() {
        assert_eq!(of("tip: Pose").ty, AnyType::of::<Pose>());
        let joints = of("joints: JointState[2]");
        let value = trocar_sdk::from_bytes::<JointState>(&joints.blank).unwrap();
        assert_eq!((joints.ty, value.position.len()), (AnyType::of::<JointState>(), 2));
        assert_eq!(of("count: u64").ty, AnyType::of::<u64>());
        assert_eq!(of("angles: f32[6]").ty, AnyType::of::<[f32; 6]>());
        // The name of a field, since it has a unit.
        assert_eq!(of("a: Pose mm").ty.unit("Pose"), "mm");
    }

    #[test]
    fn what_is_no_description_is_quoted_with_what_to_write() {
        for (text, why) in [
            ("force", "no `:` in it; write NAME: FIELD UNIT"),
            ("force:", "a field without a name"),
            ("force: fx newton", "did you mean `N`"),
            ("force: fx N, fx N", "`fx` is there twice"),
            ("force: fx N mm", "one word too many"),
            ("force: f[0] N", "give 1 to 1024 items"),
            ("force: f[x", "give 1 to 1024 items"),
            ("force: 1x N", "is not a name"),
            ("force: stamp", "`stamp` is there already"),
            ("force: fx =", "nothing behind `=`"),
            ("joints: JointState", "how many joints?"),
            ("tip: Pose[3]", "is not an array"),
        ] {
            let said = Described::read(text).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(said.contains(why) && said.contains(text), "{text}: {said}");
        }
    }
}

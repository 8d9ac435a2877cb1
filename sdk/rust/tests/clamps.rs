//! Lists and texts of any bytes never reach beyond their room, whatever length they claim and whatever they
//! hold.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use trocar_sdk::prelude::*;
use trocar_sdk::{Payload, as_bytes, from_bytes};

/// Bytes of a length and `room`, where the length is honest, a little wrong, or absurd.
fn claiming(room: usize, items: u64) -> impl Strategy<Value = Vec<u8>> {
    let length = prop_oneof![0..=items, items + 1..items + 9, Just(u64::MAX), Just(1 << 32), any::<u64>()];
    (length, prop::collection::vec(any::<u8>(), room))
        .prop_map(|(length, room)| length.to_ne_bytes().into_iter().chain(room).collect())
}

fn claimed(bytes: &[u8]) -> u64 {
    u64::from_ne_bytes(bytes[..8].try_into().unwrap())
}

proptest! {
    #[test]
    fn a_list_shows_what_it_claims_and_at_most_what_it_has(bytes in claiming(24, 6), item in any::<u32>()) {
        let mut list: List<u32, 6> = from_bytes(&bytes).unwrap();
        let len = claimed(&bytes).min(6) as usize;
        prop_assert_eq!(list.len(), len);
        for (shown, held) in list.iter().zip(bytes[8..].chunks_exact(4)) {
            prop_assert_eq!(shown.to_ne_bytes(), held);
        }
        prop_assert_eq!(list.iter().count(), len);
        list.iter_mut().for_each(|shown| *shown = shown.wrapping_add(1));
        let before = list.to_vec();
        let pushed = list.push(item);
        prop_assert_eq!(pushed, len < 6);
        prop_assert_eq!(&list[..len], &before[..]);
        prop_assert_eq!(list.get(len).copied(), pushed.then_some(item));
        list.clear();
        prop_assert!(list.is_empty() && as_bytes(&list).iter().all(|byte| *byte == 0));
    }

    #[test]
    fn a_text_of_any_bytes_is_the_utf8_they_begin_with(bytes in claiming(16, 16)) {
        let text: Text<16> = from_bytes(&bytes).unwrap();
        let room = &bytes[8..8 + claimed(&bytes).min(16) as usize];
        prop_assert!(room.starts_with(text.as_str().as_bytes()));
        let rest = &room[text.len()..];
        // Nothing that follows could have been shown as well.
        prop_assert!(rest.is_empty() || (1..=rest.len().min(4)).all(|n| std::str::from_utf8(&rest[..n]).is_err()));
    }

    #[test]
    fn a_text_holds_as_many_whole_characters_as_fit(given in any::<String>()) {
        let text = Text::<16>::new(&given);
        prop_assert!(given.starts_with(text.as_str()) && text.len() <= 16);
        let next = given[text.len()..].chars().next();
        prop_assert!(next.is_none_or(|c| text.len() + c.len_utf8() > 16), "room was left: {:?}", text);
        let tail = &as_bytes(&text)[8 + text.len()..];
        prop_assert!(tail.iter().all(|byte| *byte == 0), "its tail is zeroed");
        prop_assert_eq!(from_bytes::<Text<16>>(as_bytes(&text)).unwrap(), text);
    }

    #[test]
    fn a_list_takes_the_first_items_that_fit(items in prop::collection::vec(any::<f64>(), 0..9)) {
        let list = List::<f64, 4>::of(&items);
        prop_assert_eq!(list.len(), items.len().min(4));
        prop_assert!(list.iter().zip(&items).all(|(a, b)| a.to_bits() == b.to_bits()));
        let held = size_of::<f64>() * list.len();
        prop_assert!(as_bytes(&list)[8 + held..].iter().all(|byte| *byte == 0), "its tail is zeroed");
    }

    #[test]
    fn bytes_of_another_length_are_no_payload(bytes in prop::collection::vec(any::<u8>(), 0..64)) {
        fn fits<T: Payload>(bytes: &[u8]) -> bool {
            from_bytes::<T>(bytes).is_some()
        }
        prop_assert_eq!(fits::<List<f64, 4>>(&bytes), bytes.len() == 40);
        prop_assert_eq!(fits::<Text<16>>(&bytes), bytes.len() == 24);
    }
}

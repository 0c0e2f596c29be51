//! Recordings: every line both ways, every operator event, every wake-up, in the order in which the
//! agent met them.
//!
//! A recording (`session.usar`) is a magic, then blocks. A block is its compressed length, its
//! uncompressed length and a CRC-32 of the compressed bytes (three little-endian `u32`), followed by
//! zstd-compressed entries. Blocks are only appended, and each is whole in itself: a crash loses at
//! most the block that was being filled ([`Writer`] closes one at least every
//! [`BLOCK_SPAN`] of session time). An empty block is the end of a recording that was closed: without
//! it, what was being filled when the writer was stopped is missing. Nothing in it depends on the wall date, the host or a path, so
//! the same mission gives the same bytes.

mod codec;
mod reader;
mod writer;

pub use codec::{Direction, Entry, Header, What};
pub use reader::{ReadError, Recording, read};
pub use writer::Writer;

use crate::time::Span;

/// First bytes of every recording.
pub const MAGIC: &[u8; 8] = b"USARSES\n";

/// Version of the format this code writes; readers refuse newer ones by name.
pub const FORMAT_VERSION: u32 = 2;

/// First version whose recordings end with an empty block.
const VERSION_WITH_END: u32 = 2;

/// Session time after which an open block is closed even when it is small.
pub const BLOCK_SPAN: Span = Span::from_millis(2_000);

/// Uncompressed size at which a block is closed.
pub const BLOCK_BYTES: usize = 256 * 1024;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Arrival;
    use proptest::prelude::*;

    fn header() -> Header {
        Header {
            seed: 7,
            scenario: "box".into(),
            config: "[agent]\n".into(),
            placement: crate::mission::Placement::Start("A".into()),
        }
    }

    fn entry_strategy() -> impl Strategy<Value = Entry> {
        let bytes = || prop::collection::vec(any::<u8>(), 0..200);
        let what = prop_oneof![
            bytes().prop_map(What::Received),
            bytes().prop_map(What::Sent),
            bytes().prop_map(What::Operator),
            Just(What::Wake),
            Just(What::Connected),
            ".*".prop_map(What::Disconnected),
        ];
        (0..1_000_000_000_000_i64, what).prop_map(|(at, what)| Entry { arrival: Arrival(at), what })
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(entries in prop::collection::vec(entry_strategy(), 0..60)) {
            let mut writer = Writer::new(Vec::new(), &header()).unwrap();
            for entry in &entries {
                writer.push(entry).unwrap();
            }
            let bytes = writer.finish().unwrap();
            let recording = read(&bytes).unwrap();
            prop_assert_eq!(&recording.header, &header());
            prop_assert_eq!(&recording.entries, &entries);
            prop_assert!(recording.loss.is_none());
        }

        #[test]
        fn any_cut_keeps_the_whole_blocks(cut in 0.0..1.0f64) {
            let mut writer = Writer::new(Vec::new(), &header()).unwrap();
            for i in 0..50_i64 {
                let arrival = Arrival(i * BLOCK_SPAN.0 / 3);
                writer.push(&Entry { arrival, what: What::Received(vec![i as u8; 40]) }).unwrap();
            }
            let bytes = writer.finish().unwrap();
            let kept = &bytes[..(bytes.len() as f64 * cut) as usize];
            match read(kept) {
                Ok(recording) => {
                    prop_assert!(recording.entries.len() <= 50);
                    for (i, entry) in recording.entries.iter().enumerate() {
                        prop_assert_eq!(entry.arrival.0, i as i64 * BLOCK_SPAN.0 / 3);
                    }
                }
                Err(error) => prop_assert!(matches!(error, ReadError::NoHeader | ReadError::NotARecording), "{error}"),
            }
        }

        #[test]
        fn no_bytes_panic_the_reader(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            let mut with_magic = MAGIC.to_vec();
            with_magic.extend_from_slice(&bytes);
            let _ = read(&with_magic);
            let _ = read(&bytes);
        }
    }

    fn two_blocks() -> Vec<u8> {
        let mut writer = Writer::new(Vec::new(), &header()).unwrap();
        writer.push(&Entry { arrival: Arrival(1), what: What::Wake }).unwrap();
        writer.flush_block().unwrap();
        writer.push(&Entry { arrival: Arrival(2), what: What::Wake }).unwrap();
        writer.finish().unwrap()
    }

    #[test]
    fn a_flipped_bit_anywhere_is_found_and_the_blocks_before_it_are_kept() {
        let whole = two_blocks();
        let mut kept = std::collections::BTreeSet::new();
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 1;
            if let Ok(recording) = read(&bytes) {
                assert!(recording.loss.is_some(), "byte {at}");
                kept.insert(recording.entries.len());
            }
        }
        assert_eq!(kept.into_iter().collect::<Vec<_>>(), [0, 1, 2]);
    }

    #[test]
    fn a_recording_whose_writer_was_killed_lacks_its_end() {
        // All blocks that had been closed are there, and nothing after them.
        let whole = two_blocks();
        let ends: Vec<usize> = (1..whole.len())
            .filter(|end| {
                read(&whole[..*end]).is_ok_and(|recording| {
                    recording.loss.is_some_and(|loss| loss.contains("the end is missing"))
                })
            })
            .collect();
        assert_eq!(ends.len(), 3, "after the header and after each block: {ends:?}");
        assert_eq!(read(&whole).unwrap().loss, None);
    }
}

use super::{Entry, FORMAT_VERSION, Header, MAGIC, VERSION_WITH_END};

/// A block of more than this was never written by us; a damaged length is not believed.
const LARGEST_BLOCK: usize = 64 * 1024 * 1024;

/// A recording in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// What the recording says about itself.
    pub header: Header,
    /// The entries of all whole blocks, in order.
    pub entries: Vec<Entry>,
    /// What is missing at the end and why, where the recording is not whole.
    pub loss: Option<String>,
}

/// Why a recording could not be opened.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum ReadError {
    /// The file begins with something else.
    #[error("not a session recording: it does not begin with the magic \"USARSES\"")]
    NotARecording,
    /// The first block is damaged or cut.
    #[error("the recording's header is cut or damaged; nothing can be read from it")]
    NoHeader,
    /// The recording was written by a later version.
    #[error("recording has format version {found}, this program reads up to {FORMAT_VERSION}")]
    TooNew {
        /// Version in the file.
        found: u32,
    },
}

/// Reads a whole recording from memory. Damage after the header is not an error: the entries before
/// it are given, and [`Recording::loss`] says where reading ended.
///
/// # Errors
///
/// When there is no readable header.
pub fn read(bytes: &[u8]) -> Result<Recording, ReadError> {
    let body = bytes.strip_prefix(MAGIC).ok_or(ReadError::NotARecording)?;
    let (first, mut at) = block_at(body, 0).map_err(|_| ReadError::NoHeader)?;
    let (version, rest): (u32, _) =
        postcard::take_from_bytes(&first).map_err(|_| ReadError::NoHeader)?;
    if version > FORMAT_VERSION {
        return Err(ReadError::TooNew { found: version });
    }
    let header: Header = postcard::from_bytes(rest).map_err(|_| ReadError::NoHeader)?;
    let mut entries = Vec::new();
    let mut loss = None;
    let mut closed = false;
    while at < body.len() && loss.is_none() {
        match block_at(body, at) {
            Ok((block, next)) => {
                closed = block.is_empty();
                loss = decode_entries(&block, &mut entries)
                    .err()
                    .map(|reason| format!("block at byte {}: {reason}", at + MAGIC.len()));
                at = next;
            }
            Err(reason) => loss = Some(format!("block at byte {}: {reason}", at + MAGIC.len())),
        }
    }
    if loss.is_none() && !closed && version >= VERSION_WITH_END {
        let until_s = entries.last().map_or(0.0, |entry| entry.arrival.seconds());
        loss = Some(format!(
            "the end is missing: its writer was stopped before it closed the recording; {} entries \
             until {until_s:.1} s are there",
            entries.len()
        ));
    }
    Ok(Recording { header, entries, loss })
}

fn decode_entries(mut block: &[u8], entries: &mut Vec<Entry>) -> Result<(), String> {
    while !block.is_empty() {
        let (entry, rest) = postcard::take_from_bytes(block)
            .map_err(|error| format!("entry unreadable: {error}"))?;
        entries.push(entry);
        block = rest;
    }
    Ok(())
}

/// The uncompressed block at `at` and where the next one begins.
fn block_at(body: &[u8], at: usize) -> Result<(Vec<u8>, usize), String> {
    let word = |k: usize| -> Option<usize> {
        let bytes = body.get(at + 4 * k..at + 4 * k + 4)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?) as usize)
    };
    let (Some(packed_len), Some(raw_len), Some(checksum)) = (word(0), word(1), word(2)) else {
        return Err(format!("cut after {} bytes of its head", body.len() - at));
    };
    if packed_len > LARGEST_BLOCK || raw_len > LARGEST_BLOCK {
        return Err(format!("impossible length {packed_len} / {raw_len}"));
    }
    let start = at + 12;
    let packed = body
        .get(start..start + packed_len)
        .ok_or_else(|| format!("cut: {} of {packed_len} bytes are there", body.len() - start))?;
    if crc32fast::hash(packed) as usize != checksum {
        return Err("checksum does not match".into());
    }
    let raw = zstd::bulk::decompress(packed, raw_len).map_err(|error| error.to_string())?;
    if raw.len() != raw_len {
        return Err(format!("{} bytes unpacked, {raw_len} promised", raw.len()));
    }
    Ok((raw, start + packed_len))
}

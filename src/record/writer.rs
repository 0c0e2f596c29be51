use super::{BLOCK_BYTES, BLOCK_SPAN, Entry, FORMAT_VERSION, Header, MAGIC};
use crate::time::Arrival;
use std::io::{self, Write};

/// Level 3 is zstd's default; a session line compresses about eight to one with it.
const COMPRESSION_LEVEL: i32 = 3;

/// Appends entries to a recording.
#[derive(Debug)]
pub struct Writer<W: Write> {
    sink: W,
    block: Vec<u8>,
    block_began: Option<Arrival>,
}

impl<W: Write> Writer<W> {
    /// Begins a recording: magic, then the header in a block of its own.
    ///
    /// # Errors
    ///
    /// Whatever the sink reports.
    pub fn new(mut sink: W, header: &Header) -> io::Result<Self> {
        sink.write_all(MAGIC)?;
        let mut writer = Self { sink, block: Vec::new(), block_began: None };
        writer.encode(&FORMAT_VERSION)?;
        writer.encode(header)?;
        writer.flush_block()?;
        Ok(writer)
    }

    /// Appends an entry; closes the block when it is large or old enough.
    ///
    /// # Errors
    ///
    /// Whatever the sink reports.
    pub fn push(&mut self, entry: &Entry) -> io::Result<()> {
        let began = *self.block_began.get_or_insert(entry.arrival);
        if entry.arrival - began >= BLOCK_SPAN {
            self.flush_block()?;
            self.block_began = Some(entry.arrival);
        }
        self.encode(entry)?;
        if self.block.len() >= BLOCK_BYTES {
            self.flush_block()?;
        }
        Ok(())
    }

    /// Closes the open block and hands it to the sink.
    ///
    /// # Errors
    ///
    /// Whatever the sink reports.
    pub fn flush_block(&mut self) -> io::Result<()> {
        if self.block.is_empty() {
            return Ok(());
        }
        self.write_block()
    }

    fn write_block(&mut self) -> io::Result<()> {
        let packed = zstd::bulk::compress(&self.block, COMPRESSION_LEVEL)?;
        let mut head = Vec::with_capacity(12 + packed.len());
        head.extend_from_slice(&(packed.len() as u32).to_le_bytes());
        head.extend_from_slice(&(self.block.len() as u32).to_le_bytes());
        head.extend_from_slice(&crc32fast::hash(&packed).to_le_bytes());
        head.extend_from_slice(&packed);
        self.sink.write_all(&head)?;
        self.sink.flush()?;
        self.block.clear();
        self.block_began = None;
        Ok(())
    }

    /// Closes the last block, marks the end and gives the sink back.
    ///
    /// # Errors
    ///
    /// Whatever the sink reports.
    pub fn finish(mut self) -> io::Result<W> {
        self.flush_block()?;
        self.write_block()?;
        Ok(self.sink)
    }

    fn encode<T: serde::Serialize>(&mut self, value: &T) -> io::Result<()> {
        postcard::to_io(value, &mut self.block).map_err(io::Error::other)?;
        Ok(())
    }
}

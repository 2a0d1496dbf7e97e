use std::io;
use std::sync::mpsc;

/// Address space that must be left before a thread is started, bytes. Larger than any block that an
/// allocator serves from memory it already holds (32 MiB in the GNU C library), so that the system
/// is asked.
const ROOM_BYTES: usize = 64 << 20;

/// Starts a thread of a pool, and returns when it runs: the handler for
/// [`rayon::ThreadPoolBuilder::spawn_handler`].
///
/// A thread takes memory of its own when it begins (for its signal handler), and the standard
/// library ends the whole process if the system refuses that. Pools started by this are refused
/// with an error instead, while there is room for it.
///
/// # Errors
/// [`io::ErrorKind::OutOfMemory`] if the system has no room for the thread; the system's error if
/// it refuses the thread.
///
/// ```
/// let builder = rayon::ThreadPoolBuilder::new().num_threads(2);
/// let pool = builder.spawn_handler(luxel_lanes::start_thread).build();
/// assert_eq!(pool.unwrap().current_num_threads(), 2);
/// ```
pub fn start_thread(thread: rayon::ThreadBuilder) -> io::Result<()> {
    let mut room = Vec::<u8>::new();
    let stack_bytes = thread.stack_size().unwrap_or(0);
    room.try_reserve_exact(ROOM_BYTES.saturating_add(stack_bytes)).map_err(|_| io::Error::from(io::ErrorKind::OutOfMemory))?;
    drop(std::hint::black_box(room));
    let mut builder = std::thread::Builder::new();
    if let Some(name) = thread.name() {
        builder = builder.name(name.to_owned());
    }
    if let Some(bytes) = thread.stack_size() {
        builder = builder.stack_size(bytes);
    }
    let (begun, wait) = mpsc::channel();
    builder.spawn(move || {
        // Whoever waits is gone only with the whole process.
        let _ = begun.send(());
        thread.run();
    })?;
    wait.recv().map_err(io::Error::other)
}

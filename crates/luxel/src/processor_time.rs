//! Time that processors have spent on this process, all threads together.

/// Returns the seconds in user and kernel mode; `None` where the system does not tell.
#[cfg(unix)]
pub fn processor_seconds() -> Option<f64> {
    use nix::sys::resource::{UsageWho, getrusage};
    use nix::sys::time::TimeVal;
    let usage = getrusage(UsageWho::RUSAGE_SELF).ok()?;
    let seconds = |time: TimeVal| time.tv_sec() as f64 + 1e-6 * time.tv_usec() as f64;
    Some(seconds(usage.user_time()) + seconds(usage.system_time()))
}

/// Returns `None`: the standard library has no such clock.
#[cfg(not(unix))]
pub fn processor_seconds() -> Option<f64> {
    None
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn work_takes_processor_time() {
        let before = processor_seconds().unwrap();
        assert!(before >= 0.0);
        // Until the clock, which may tick coarsely, has moved: this loop is the work.
        while processor_seconds().unwrap() <= before {
            std::hint::spin_loop();
        }
    }
}

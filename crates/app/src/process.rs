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

/// Returns the resident memory (`VmRSS`).
pub fn resident_bytes() -> Option<u64> {
    status_bytes("VmRSS:")
}

/// Returns the peak of resident memory (`VmHWM`).
pub fn peak_resident_bytes() -> Option<u64> {
    status_bytes("VmHWM:")
}

fn status_bytes(key: &str) -> Option<u64> {
    field_bytes(&std::fs::read_to_string("/proc/self/status").ok()?, key)
}

fn field_bytes(status: &str, key: &str) -> Option<u64> {
    let rest = status.lines().find_map(|line| line.strip_prefix(key))?;
    rest.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(unix)]
    fn work_takes_processor_time() {
        let before = processor_seconds().unwrap();
        assert!(before >= 0.0);
        // Until the clock, which may tick coarsely, has moved: this loop is the work.
        while processor_seconds().unwrap() <= before {
            std::hint::spin_loop();
        }
    }

    #[test]
    fn kilobytes_of_a_field_become_bytes() {
        let status = "Name:\tluxel\nVmHWM:\t    2048 kB\nVmRSS:\t 3 kB\n";
        assert_eq!(field_bytes(status, "VmHWM:"), Some(2048 * 1024));
        assert_eq!(field_bytes(status, "VmRSS:"), Some(3 * 1024));
        assert_eq!(field_bytes(status, "VmSwap:"), None);
    }
}

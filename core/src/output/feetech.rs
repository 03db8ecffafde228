//! Serial bus servos of Feetech, series STS and SCS: one packet moves all of them.
//!
//! In:  a servo command; its calibration counts positions of the servo in place of microseconds.
//! Out: bytes for the half-duplex line. Such packets are not answered, so nothing has to be read.
//!
//! Source: Feetech SMS/STS and SCS protocol manuals: `FF FF id length instruction parameters checksum`; length counts
//! from the instruction on, the checksum is the complement of the sum from the id on.

use super::packet::{BufferTooSmall, Packet, driven, torques};

const EVERYONE: u8 = 0xFE;
const SYNC_WRITE: u8 = 0x83;
const TORQUE_ENABLE: u8 = 0x28;
const GOAL_POSITION: u8 = 0x2A;

/// Largest number of servos in a packet whose length fits its byte.
const SERVOS_MAX: usize = 83;

/// A series of servos: they differ in the order of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feetech {
    /// STS and SMS, 4096 positions a turn: the low byte first.
    Sts,
    /// SCS, 1024 positions: the high byte first.
    Scs,
}

impl Feetech {
    /// A packet that sends servo `ids[i]` to `positions[i]`. A servo of position 0 is left out: it is released, see
    /// [`encode_torque`](Self::encode_torque).
    ///
    /// # Errors
    /// [`BufferTooSmall`]; 3 bytes a servo and 8 are enough.
    pub fn encode_goals<'b>(
        self,
        ids: &[u8],
        positions: &[u16],
        buffer: &'b mut [u8],
    ) -> Result<&'b [u8], BufferTooSmall> {
        let goals = driven(ids, positions).map(|(id, position)| (id, self.bytes(position)));
        sync_write(GOAL_POSITION, goals, buffer)
    }

    /// A packet that switches servo `ids[i]` on, or off where `positions[i]` is 0. To be sent when that changes.
    ///
    /// # Errors
    /// [`BufferTooSmall`]; 2 bytes a servo and 8 are enough.
    pub fn encode_torque<'b>(
        self,
        ids: &[u8],
        positions: &[u16],
        buffer: &'b mut [u8],
    ) -> Result<&'b [u8], BufferTooSmall> {
        sync_write(TORQUE_ENABLE, torques(ids, positions), buffer)
    }

    const fn bytes(self, value: u16) -> [u8; 2] {
        match self {
            Self::Sts => value.to_le_bytes(),
            Self::Scs => value.to_be_bytes(),
        }
    }
}

fn sync_write<const WIDTH: usize>(
    address: u8,
    servos: impl Iterator<Item = (u8, [u8; WIDTH])>,
    buffer: &mut [u8],
) -> Result<&[u8], BufferTooSmall> {
    let mut packet = Packet::new(buffer);
    packet.extend(&[0xFF, 0xFF, EVERYONE, 0, SYNC_WRITE, address, WIDTH as u8]);
    for (id, data) in servos.take(SERVOS_MAX) {
        packet.push(id);
        packet.extend(&data);
    }
    // Instruction, parameters and checksum.
    packet.set(3, (packet.len() - 3) as u8);
    let sum = packet.since(2).iter().fold(0_u8, |sum, &byte| sum.wrapping_add(byte));
    packet.push(!sum);
    packet.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffer_that_is_too_small_is_refused_with_what_is_needed() {
        let refused = Feetech::Sts.encode_goals(&[1, 2], &[2048, 2048], &mut [0; 13]).err();
        assert_eq!(refused, Some(BufferTooSmall { bytes: 13, needed: 14 }));
    }

    #[test]
    fn packet_of_four_servos_is_that_of_the_manual() {
        let data = [0x08, 0x00, 0x00, 0x00, 0x03, 0xE8];
        let mut buffer = [0; 64];
        let manual = [
            0xFF, 0xFF, 0xFE, 0x20, 0x83, 0x2A, 6, 1, 8, 0, 0, 0, 3, 0xE8, 2, 8, 0, 0, 0, 3, 0xE8,
            3, 8, 0, 0, 0, 3, 0xE8, 4, 8, 0, 0, 0, 3, 0xE8, 0x58,
        ];
        let servos = (1..=4).map(|id| (id, data));
        assert_eq!(sync_write(GOAL_POSITION, servos, &mut buffer).unwrap(), manual);
    }

    #[test]
    fn series_differ_in_the_order_of_bytes() {
        let mut buffer = [0; 16];
        let sts = Feetech::Sts.encode_goals(&[7], &[0x0801], &mut buffer).unwrap();
        assert_eq!(sts, [0xFF, 0xFF, 0xFE, 7, 0x83, 0x2A, 2, 7, 1, 8, 0x3B]);
        let scs = Feetech::Scs.encode_goals(&[7], &[0x0801], &mut buffer).unwrap();
        assert_eq!(scs[7..10], [7, 8, 1]);
    }

    #[test]
    fn released_servo_gets_no_goal_and_no_torque() {
        let (ids, positions) = ([3, 4], [0, 900]);
        let mut buffer = [0; 32];
        let goals = Feetech::Scs.encode_goals(&ids, &positions, &mut buffer).unwrap();
        assert_eq!((goals.len(), goals[7]), (11, 4));
        let torque = Feetech::Scs.encode_torque(&ids, &positions, &mut buffer).unwrap();
        assert_eq!(torque[4..11], [0x83, 0x28, 1, 3, 0, 4, 1]);
    }
}

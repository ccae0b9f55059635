// modbus-serial as a server with the least PLC in its memory; it knows no function 23. `node server.js PORT`.
const ModbusRTU = require("modbus-serial");

const words = new Uint16Array(132);

function obey(command) {
    if (command === 1) {
        words[110] += 1;
        words[113] = 500 + words[110];
        words[105] |= 5; // photoelectric switch, clamped
    } else if (command === 2 || command === 3) {
        words[105] &= ~5;
    }
    words[109] = command >= 1 && command <= 5 ? 0 : 2;
}

function scan() {
    words[100] += 1;
    words.set([0x0100, words[1], 1, 0xf], 101);
    if (words[3] !== words[107]) {
        obey(words[4]);
        words[107] = words[108] = words[3];
    }
    const sucking = words[6] & 1;
    words[105] = (words[105] & ~2) | 8 | (sucking << 1);
    words[115] = sucking ? 0x10000 - 700 : 0;
    words[116] = 100;
    words[117] = 1;
}

const vector = {
    getHoldingRegister: (address) => words[address],
    getMultipleHoldingRegisters: (address, count) => {
        scan();
        return Array.from(words.slice(address, address + count));
    },
    setRegister: (address, value) => {
        words[address] = value;
    },
};
const server = new ModbusRTU.ServerTCP(vector, { host: "127.0.0.1", port: Number(process.argv[2]), unitID: 1 });
server.on("initialized", () => console.log("listening"));

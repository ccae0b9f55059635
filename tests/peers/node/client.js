// modbus-serial as a client: every function, then many requests at once. `node client.js PORT` prints what it got as JSON.
const ModbusRTU = require("modbus-serial");

async function refusal(request) {
    try {
        await request;
        return null;
    } catch (error) {
        return error.modbusCode;
    }
}

async function main(port) {
    const client = new ModbusRTU();
    await client.connectTCP("127.0.0.1", { port });
    client.setID(1);
    client.setTimeout(2000);
    const coils = [true, false, true, true, false, false, true, true, true, false];
    await client.writeCoils(19, coils);
    await client.writeCoil(50, true);
    await client.writeRegisters(0, [1, 2, 3]);
    await client.writeRegister(3, 4);
    await client.maskWriteRegister(3, 0xfff0, 0x000a);
    const got = {
        coils: (await client.readCoils(19, 10)).data.slice(0, 10),
        inputs: (await client.readDiscreteInputs(0, 10)).data.slice(0, 10),
        holding: (await client.readHoldingRegisters(0, 4)).data,
        input_words: (await client.readInputRegisters(0, 1)).data,
        vendor: (await client.readDeviceIdentification(1, 0)).data[0],
        no_address: await refusal(client.readHoldingRegisters(16, 1)),
        no_function: await refusal(client.customFunction(0x41, [1, 2])),
    };
    const at_once = Array.from({ length: 32 }, (_, n) => client.readHoldingRegisters(100 + n, 1));
    got.at_once = (await Promise.all(at_once)).map((answer) => answer.data[0]);
    client.close(() => {});
    console.log(JSON.stringify(got));
}

main(Number(process.argv[2])).catch((error) => {
    console.error(error);
    process.exit(1);
});
